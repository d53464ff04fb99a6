//! Fills what the charts leave free, so that filtering and mipmaps never see a foreign colour at a seam.

/// A square picture with holes: `[size²]` sRGB in 0…255 and what is known.
pub(super) struct Canvas {
    pub size: usize,
    pub rgb: Vec<[f32; 3]>,
    pub known: Vec<bool>,
}

impl Canvas {
    pub fn new(size: usize) -> Self {
        Self { size, rgb: vec![[0.0; 3]; size * size], known: vec![false; size * size] }
    }

    /// Makes a texel known; `rgb` in [0, 1].
    pub fn set(&mut self, at: usize, rgb: [f32; 3]) {
        self.rgb[at] = rgb.map(|x| 255.0 * x.clamp(0.0, 1.0));
        self.known[at] = true;
    }

    fn neighbours(&self, at: usize) -> impl Iterator<Item = usize> + use<> {
        let (size, x, y) = (self.size, at % self.size, at / self.size);
        let rows = y.saturating_sub(1)..=(y + 1).min(size - 1);
        rows.flat_map(move |j| (x.saturating_sub(1)..=(x + 1).min(size - 1)).map(move |i| j * size + i))
            .filter(move |&n| n != at)
    }

    /// Grows the known area by `rings` texels; a new texel is the mean of its known neighbours.
    pub fn dilate(&mut self, rings: usize) {
        let touches = |canvas: &Self, at: usize| canvas.neighbours(at).any(|n| canvas.known[n]);
        let mut front: Vec<usize> = (0..self.known.len()).filter(|&at| !self.known[at] && touches(self, at)).collect();
        for _ in 0..rings {
            for &at in &front {
                let (mut sum, mut n) = ([0.0; 3], 0.0);
                for other in self.neighbours(at).filter(|&o| self.known[o]) {
                    (0..3).for_each(|k| sum[k] += self.rgb[other][k]);
                    n += 1.0;
                }
                self.rgb[at] = sum.map(|s| s / n);
            }
            front.iter().for_each(|&at| self.known[at] = true);
            let mut next: Vec<usize> =
                front.iter().flat_map(|&at| self.neighbours(at)).filter(|&n| !self.known[n]).collect();
            next.sort_unstable();
            next.dedup();
            front = next;
        }
    }

    /// Fills the rest smoothly from coarser and coarser means (push-pull). Black where nothing is known.
    pub fn push_pull(&mut self) {
        if self.size == 1 || self.known.iter().all(|k| *k) {
            return;
        }
        let half = self.size.div_ceil(2);
        let mut coarse = Canvas::new(half);
        let mut counts = vec![0.0f32; half * half];
        for (at, rgb) in self.rgb.iter().enumerate().filter(|(at, _)| self.known[*at]) {
            let to = at / self.size / 2 * half + at % self.size / 2;
            (0..3).for_each(|k| coarse.rgb[to][k] += rgb[k]);
            counts[to] += 1.0;
        }
        for (to, count) in counts.into_iter().enumerate().filter(|(_, count)| *count > 0.0) {
            coarse.rgb[to] = coarse.rgb[to].map(|x| x / count);
            coarse.known[to] = true;
        }
        coarse.push_pull();
        for at in 0..self.rgb.len() {
            if !self.known[at] {
                self.rgb[at] = coarse.between(at % self.size, at / self.size);
                self.known[at] = true;
            }
        }
    }

    /// The bilinear colour of this picture at the texel (`x`, `y`) of one twice its size.
    fn between(&self, x: usize, y: usize) -> [f32; 3] {
        // A fine texel's centre lies a quarter of a coarse texel from its parent's, towards the even or the odd side.
        let other =
            |i: usize| if i.is_multiple_of(2) { (i / 2).saturating_sub(1) } else { (i / 2 + 1).min(self.size - 1) };
        let at = |x: usize, y: usize| self.rgb[y * self.size + x];
        let (near, far) = ([x / 2, y / 2], [other(x), other(y)]);
        let corners = [at(near[0], near[1]), at(far[0], near[1]), at(near[0], far[1]), at(far[0], far[1])];
        std::array::from_fn(|k| {
            (9.0 * corners[0][k] + 3.0 * corners[1][k] + 3.0 * corners[2][k] + corners[3][k]) / 16.0
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spot(size: usize, at: &[usize]) -> Canvas {
        let mut canvas = Canvas::new(size);
        for (i, &at) in at.iter().enumerate() {
            canvas.rgb[at] = [100.0 * (i + 1) as f32; 3];
            canvas.known[at] = true;
        }
        canvas
    }

    #[test]
    fn dilation_grows_by_whole_rings() {
        let mut canvas = spot(9, &[40]);
        canvas.dilate(2);
        for at in 0..81 {
            let inside = (at % 9usize).abs_diff(4) <= 2 && (at / 9usize).abs_diff(4) <= 2;
            assert_eq!(canvas.known[at], inside, "texel {at}");
            assert_eq!(canvas.rgb[at][0], if inside { 100.0 } else { 0.0 });
        }
    }

    #[test]
    fn push_pull_fills_everything_and_keeps_what_is_known() {
        let mut canvas = spot(7, &[0, 48]);
        canvas.push_pull();
        assert!(canvas.known.iter().all(|k| *k));
        assert_eq!((canvas.rgb[0][0], canvas.rgb[48][0]), (100.0, 200.0));
        assert!(canvas.rgb.iter().all(|c| (100.0..=200.0).contains(&c[0])));
    }
}
