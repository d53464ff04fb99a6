//! Curves as inline SVG.

use std::fmt::Write;

use super::escape;

/// A named line through points (x, y).
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    pub name: String,
    pub points: Vec<(f64, f64)>,
}

const WIDTH: f64 = 560.0;
const HEIGHT: f64 = 230.0;
const LEFT: f64 = 52.0;
const BOTTOM: f64 = 26.0;
const TOP: f64 = 8.0;
/// Room for the names.
const RIGHT: f64 = 140.0;
const COLOURS: usize = 7;

/// Curves over one x axis; y runs from 0 to the largest value of all. Points that are not finite are left out.
pub fn chart(x_name: &str, curves: &[Curve]) -> String {
    let drawn = |c: &Curve| -> Vec<(f64, f64)> {
        c.points.iter().copied().filter(|(x, y)| x.is_finite() && y.is_finite()).collect()
    };
    let lines: Vec<Vec<(f64, f64)>> = curves.iter().map(drawn).collect();
    let all = || lines.iter().flatten();
    let (x0, x1) = range(all().map(|p| p.0));
    let high = all().map(|p| p.1).fold(f64::MIN_POSITIVE, f64::max);
    let px = |x: f64| LEFT + (WIDTH - LEFT - RIGHT) * (x - x0) / (x1 - x0).max(1e-9);
    let py = |y: f64| TOP + (HEIGHT - TOP - BOTTOM) * (1.0 - y.max(0.0) / high);
    let mut svg = format!("<svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" width=\"{WIDTH}\" role=\"img\">");
    for quarter in 0..=4 {
        let value = 0.25 * f64::from(quarter) * high;
        let (y, right) = (py(value), WIDTH - RIGHT);
        let _ = write!(svg, "<line class=grid x1=\"{LEFT}\" x2=\"{right}\" y1=\"{y:.1}\" y2=\"{y:.1}\"/>");
        let name = (1e3 * value).round() / 1e3;
        let _ = write!(svg, "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{name}</text>", LEFT - 6.0, y + 4.0);
    }
    let floor = HEIGHT - 8.0;
    let _ = write!(svg, "<text x=\"{LEFT}\" y=\"{floor}\">{} {x0:.0} to {x1:.0}</text>", escape(x_name));
    for (k, (curve, line)) in curves.iter().zip(&lines).enumerate() {
        let colour = format!("var(--c{})", k % COLOURS);
        let mut path = String::new();
        for (i, (x, y)) in line.iter().enumerate() {
            let _ = write!(path, "{}{:.1} {:.1}", if i == 0 { "M" } else { "L" }, px(*x), py(*y));
        }
        let _ = write!(svg, "<path d=\"{path}\" style=\"stroke:{colour}\"/>");
        let (x, y) = (WIDTH - RIGHT + 10.0, TOP + 12.0 + 17.0 * k as f64);
        let name = escape(&curve.name);
        let _ = write!(svg, "<text x=\"{x}\" y=\"{y}\" style=\"fill:{colour}\">{name}</text>");
    }
    svg + "</svg>"
}

fn range(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| (l.min(x), h.max(x)));
    if low <= high { (low, high) } else { (0.0, 1.0) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_lie_where_their_values_are() {
        let curve = |points: &[(f64, f64)]| Curve { name: "loss <1>".to_owned(), points: points.to_vec() };
        let svg = chart("step", &[curve(&[(1.0, 2.0), (6.0, f64::NAN), (6.0, 1.0), (11.0, 0.0)])]);
        // Left and top, the middle, right and bottom of the frame.
        assert!(svg.contains("d=\"M52.0 8.0L236.0 106.0L420.0 204.0\""), "{svg}");
        assert!(svg.contains(">2<") && svg.contains(">0.5<") && svg.contains("loss &lt;1&gt;"));
        assert!(chart("step", &[]).starts_with("<svg"));
    }
}
