//! How far the cells of a binary image lie from the edge of what is in it.

/// `[height, width]`: from each cell's centre to the edge of `inside [height, width]`, in cells, positive outside. `None`
/// where nothing or everything is inside.
pub fn signed_distance(inside: &[bool], width: usize, height: usize) -> Option<Vec<f32>> {
    let first = *inside.first()?;
    if inside.iter().all(|v| *v == first) {
        return None;
    }
    let to_inside = squared_distance(inside, true, width, height);
    let to_outside = squared_distance(inside, false, width, height);
    let signed = |(a, b): (&f32, &f32)| if *a > 0.0 { a.sqrt() - 0.5 } else { 0.5 - b.sqrt() };
    Some(to_inside.iter().zip(&to_outside).map(signed).collect())
}

/// Squared distances in cells to the nearest cell that is `target` (Felzenszwalb and Huttenlocher 2012: lower
/// envelopes of parabolas, columns first, then rows).
fn squared_distance(inside: &[bool], target: bool, w: usize, h: usize) -> Vec<f32> {
    const FAR: f32 = 1e12;
    let mut field: Vec<f32> = inside.iter().map(|v| if *v == target { 0.0 } else { FAR }).collect();
    let longest = w.max(h);
    let mut line = vec![0.0; longest];
    let mut envelope = Envelope { vertices: vec![0; longest], starts: vec![0.0; longest + 1] };
    for x in 0..w {
        for y in 0..h {
            line[y] = field[y * w + x];
        }
        envelope.transform(&line[..h], |y, value| field[y * w + x] = value);
    }
    for y in 0..h {
        line[..w].copy_from_slice(&field[y * w..][..w]);
        envelope.transform(&line[..w], |x, value| field[y * w + x] = value);
    }
    field
}

/// Scratch of one line's transform: the parabolas that form the lower envelope, and where each takes over.
struct Envelope {
    vertices: Vec<usize>,
    starts: Vec<f32>,
}

impl Envelope {
    fn transform(&mut self, line: &[f32], mut put: impl FnMut(usize, f32)) {
        let square = |i: usize| (i * i) as f32;
        let mut last = 0;
        self.vertices[0] = 0;
        (self.starts[0], self.starts[1]) = (f32::NEG_INFINITY, f32::INFINITY);
        for q in 1..line.len() {
            loop {
                let v = self.vertices[last];
                let meet = ((line[q] + square(q)) - (line[v] + square(v))) / (2 * (q - v)) as f32;
                if meet <= self.starts[last] && last > 0 {
                    last -= 1;
                    continue;
                }
                last += 1;
                self.vertices[last] = q;
                (self.starts[last], self.starts[last + 1]) = (meet, f32::INFINITY);
                break;
            }
        }
        let mut k = 0;
        for q in 0..line.len() {
            while self.starts[k + 1] < q as f32 {
                k += 1;
            }
            let v = self.vertices[k];
            put(q, square(q.abs_diff(v)) + line[v]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_are_those_to_the_nearest_cell() {
        let (width, height) = (23, 17);
        let inside: Vec<bool> = (0..width * height).map(|i| (i * i + 3 * i) % 11 == 0).collect();
        let found = signed_distance(&inside, width, height).unwrap();
        for (i, found) in found.iter().enumerate() {
            let other = (0..width * height).filter(|&j| inside[j] != inside[i]);
            let between =
                |j: usize| ((i % width).abs_diff(j % width) as f32).hypot((i / width).abs_diff(j / width) as f32);
            let nearest = other.map(between).fold(f32::INFINITY, f32::min) - 0.5;
            let expected = if inside[i] { -nearest } else { nearest };
            assert!((found - expected).abs() < 1e-4, "cell {i}: {found} and {expected}");
        }
        assert_eq!(signed_distance(&[true; 6], 3, 2), None);
        assert_eq!(signed_distance(&[false; 6], 3, 2), None);
        assert_eq!(signed_distance(&[], 0, 0), None);
    }
}
