//! How far one picture lies beside another, in two directions: where their squared difference is least, of all whole pixels within reach
//! on a coarse picture and of the pixels around on finer ones, and then between the pixels.

/// How far a picture may be off, over its longer side.
const REACH: f64 = 0.06;
/// What of the error must go for a picture to be moved.
const GAIN: f64 = 0.02;
/// Of the pixels that are compared where the picture lies, so many must be there wherever it is moved to.
const KEPT: f64 = 0.7;

/// Where the search begins, all places within reach are tried: the longer side of a picture at most, pixels.
const COARSEST_PX: usize = 96;

/// Three channels a pixel, and what each pixel counts.
pub(super) struct Picture {
    pub width: usize,
    pub height: usize,
    pub rgb: Vec<[f32; 3]>,
    pub weights: Vec<f32>,
}

impl Picture {
    /// Of `[width, height]`; what goes beyond is left out.
    pub fn new([width, height]: [usize; 2], mut rgb: Vec<[f32; 3]>, mut weights: Vec<f32>) -> Self {
        rgb.truncate(width * height);
        weights.truncate(width * height);
        Self { width, height, rgb, weights }
    }

    /// The longer side.
    pub fn longer(&self) -> usize {
        self.width.max(self.height)
    }

    /// Half as large: the mean of four pixels, by what they count.
    fn halved(&self) -> Self {
        let (width, height) = (self.width / 2, self.height / 2);
        let mut half = Self { width, height, rgb: Vec::new(), weights: Vec::new() };
        for y in 0..height {
            for x in 0..width {
                let four = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(dx, dy)| (2 * y + dy) * self.width + 2 * x + dx);
                let weight: f32 = four.iter().map(|&i| self.weights[i]).sum();
                let sum = |k: usize| four.iter().map(|&i| self.weights[i] * self.rgb[i][k]).sum::<f32>();
                half.rgb.push([0, 1, 2].map(|k| if weight > 0.0 { sum(k) / weight } else { 0.0 }));
                half.weights.push(weight / 4.0);
            }
        }
        half
    }

    /// The mean squared difference from `other` moved by `[x, y]`, but for a channel's mean difference; `None` where too little of what
    /// is compared is in it.
    fn differs(&self, other: &Self, [dx, dy]: [i64; 2]) -> Option<f64> {
        let (mut all, mut sum, mut sums, mut squares) = (0.0, 0.0, [0.0; 3], [0.0; 3]);
        for y in 0..self.height {
            for x in 0..self.width {
                let i = y * self.width + x;
                let weight = f64::from(self.weights[i]);
                if weight == 0.0 {
                    continue;
                }
                all += weight;
                let (ox, oy) = (x as i64 + dx, y as i64 + dy);
                if ox < 0 || oy < 0 || ox >= other.width as i64 || oy >= other.height as i64 {
                    continue;
                }
                let j = oy as usize * other.width + ox as usize;
                let weight = weight * f64::from(other.weights[j]);
                sum += weight;
                for k in 0..3 {
                    let difference = f64::from(self.rgb[i][k] - other.rgb[j][k]);
                    sums[k] += weight * difference;
                    squares[k] += weight * difference * difference;
                }
            }
        }
        let variance = (0..3).map(|k| (squares[k] - sums[k] * sums[k] / sum) / sum).sum::<f64>();
        (sum > KEPT * all).then_some(variance)
    }
}

/// Both pictures halved again and again, the finest first, until the longer side has `coarsest` pixels at most, or the shorter one no
/// half: a head at the border of the image may be a few pixels wide.
pub(super) fn halves(drawn: &Picture, filmed: &Picture, coarsest: usize) -> Vec<[Picture; 2]> {
    let mut halves: Vec<[Picture; 2]> = Vec::new();
    loop {
        let [drawn, filmed] = halves.last().map_or([drawn, filmed], |[drawn, filmed]| [drawn, filmed]);
        if drawn.longer() <= coarsest || drawn.width.min(drawn.height) < 2 {
            return halves;
        }
        halves.push([drawn.halved(), filmed.halved()]);
    }
}

/// By how many pixels `drawn` must be moved to lie on `filmed`; `None` where that gains little, or leads out of reach.
pub(super) fn shift(drawn: &Picture, filmed: &Picture) -> Option<[f64; 2]> {
    let reach = |picture: &Picture| (REACH * picture.longer() as f64).ceil() as i64;
    let halves = halves(drawn, filmed, COARSEST_PX);
    let levels = halves.iter().rev().map(|[drawn, filmed]| [drawn, filmed]).chain([[drawn, filmed]]);
    let mut at = [0; 2];
    for (nth, [drawn, filmed]) in levels.enumerate() {
        let around = if nth == 0 { reach(drawn) } else { 1 };
        at = at.map(|d| 2 * d);
        let tried = (-around..=around).flat_map(|dy| (-around..=around).map(move |dx| [at[0] + dx, at[1] + dy]));
        let differences = tried.filter_map(|to| Some((drawn.differs(filmed, to)?, to)));
        at = differences.min_by(|a, b| a.0.total_cmp(&b.0))?.1;
    }
    let (least, stands) = (drawn.differs(filmed, at)?, drawn.differs(filmed, [0; 2])?);
    if least > (1.0 - GAIN) * stands || at.iter().any(|d| d.abs() >= reach(drawn)) {
        return None;
    }
    // Between the pixels: the lowest point of a parabola through three.
    let between = |axis: usize| {
        let mut beside = [at; 2];
        beside[0][axis] -= 1;
        beside[1][axis] += 1;
        let [low, high] = [drawn.differs(filmed, beside[0]), drawn.differs(filmed, beside[1])];
        let (Some(low), Some(high)) = (low, high) else { return 0.0 };
        let bend = low + high - 2.0 * least;
        if bend > 0.0 { (0.5 * (low - high) / bend).clamp(-0.5, 0.5) } else { 0.0 }
    };
    Some([0, 1].map(|axis| at[axis] as f64 + between(axis)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Blobs some ten pixels wide, in a light of their own.
    fn blobs([x, y]: [f64; 2], light: f32) -> Picture {
        let size = [120, 150];
        let at = |i: usize| [(i % size[0]) as f64 - x, (i / size[0]) as f64 - y];
        let colour =
            |[x, y]: [f64; 2]| [0.3 * x, 0.35 * y, 0.25 * (x + y)].map(|phase| light + 0.2 * phase.sin() as f32);
        Picture::new(size, (0..size[0] * size[1]).map(|i| colour(at(i))).collect(), vec![1.0; size[0] * size[1]])
    }

    #[test]
    fn a_picture_is_moved_by_fractions_of_a_pixel_and_no_further_than_it_may_be_off() {
        let here = blobs([0.0; 2], 0.5);
        let [x, y] = shift(&here, &blobs([4.6, -3.0], 0.4)).unwrap();
        assert!((x - 4.6).abs() < 0.3 && (y + 3.0).abs() < 0.3, "{x} {y}");
        let lies = shift(&here, &blobs([0.0; 2], 0.6)).unwrap_or_default();
        assert!(lies.iter().all(|d| d.abs() < 0.01), "{lies:?}");
        let mut grey = blobs([0.0; 2], 0.5);
        grey.rgb.fill([0.5; 3]);
        assert_eq!(shift(&grey, &here), None, "nothing tells where it lies");
        // A slope has its least difference ever further.
        let slope = |x: f32| {
            let mut slope = blobs([0.0; 2], 0.5);
            slope.rgb.iter_mut().enumerate().for_each(|(i, rgb)| *rgb = [1e-5 * ((i % 120) as f32 + x).powi(2); 3]);
            slope
        };
        assert_eq!(shift(&slope(0.0), &slope(40.0)), None);
    }
}
