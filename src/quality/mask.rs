//! Questions to a binary mask.

use crate::mask::is_foreground;

/// `[height, width]`
#[derive(Clone, Copy)]
pub struct Mask<'a> {
    pub width: usize,
    pub height: usize,
    pub data: &'a [u8],
}

impl Mask<'_> {
    pub fn at(&self, x: i64, y: i64) -> bool {
        let inside = (0..self.width as i64).contains(&x) && (0..self.height as i64).contains(&y);
        inside && is_foreground(self.data[y as usize * self.width + x as usize])
    }

    pub fn area(&self) -> usize {
        self.data.iter().filter(|&&v| is_foreground(v)).count()
    }

    /// Rows from the first to the last with foreground.
    pub fn height_px(&self) -> usize {
        let row = |y: &usize| self.data[y * self.width..(y + 1) * self.width].iter().any(|&v| is_foreground(v));
        let first = (0..self.height).find(row);
        let last = (0..self.height).rev().find(row);
        first.zip(last).map_or(0, |(a, b)| b + 1 - a)
    }

    /// Whether there is foreground within `radius` pixels of a point.
    pub fn is_near(&self, x: f64, y: f64, radius: f64) -> bool {
        let reach = radius.ceil() as i64;
        let (cx, cy) = (x.floor() as i64, y.floor() as i64);
        let within = |dx: i64, dy: i64| {
            let (px, py) = ((cx + dx) as f64 + 0.5 - x, (cy + dy) as f64 + 0.5 - y);
            px * px + py * py <= radius * radius
        };
        self.at(cx, cy)
            || (-reach..=reach).any(|dy| (-reach..=reach).any(|dx| within(dx, dy) && self.at(cx + dx, cy + dy)))
    }

    /// Areas of the connected parts (of eight neighbours), the largest first.
    pub fn parts(&self) -> Vec<usize> {
        let mut seen = vec![false; self.data.len()];
        let mut areas = Vec::new();
        let mut open = Vec::new();
        for start in 0..self.data.len() {
            if seen[start] || !is_foreground(self.data[start]) {
                continue;
            }
            seen[start] = true;
            open.push(start);
            let mut area = 0;
            while let Some(pixel) = open.pop() {
                area += 1;
                let (x, y) = ((pixel % self.width) as i64, (pixel / self.width) as i64);
                for (nx, ny) in (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (x + dx, y + dy))) {
                    if self.at(nx, ny) {
                        let next = ny as usize * self.width + nx as usize;
                        if !std::mem::replace(&mut seen[next], true) {
                            open.push(next);
                        }
                    }
                }
            }
            areas.push(area);
        }
        areas.sort_unstable_by(|a, b| b.cmp(a));
        areas
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mask(rows: &[&str]) -> (usize, usize, Vec<u8>) {
        let data = rows.iter().flat_map(|row| row.bytes().map(|b| if b == b'#' { 255 } else { 0 })).collect();
        (rows[0].len(), rows.len(), data)
    }

    #[test]
    fn parts_heights_and_distances() {
        let (width, height, data) = mask(&["......", ".##..#", ".##...", "...#..", "......"]);
        let mask = Mask { width, height, data: &data };
        assert_eq!(mask.parts(), [5, 1], "corners join");
        assert_eq!((mask.area(), mask.height_px()), (6, 3));
        assert!(mask.is_near(1.5, 1.5, 0.0));
        assert!(mask.is_near(0.5, 0.5, 1.5) && !mask.is_near(0.5, 0.5, 1.4));
        assert!(!mask.is_near(-50.0, 900.0, 3.0));
    }
}
