//! Faults of the device on order, for tests of what lives above it. `EFFIGY_TEST_DEVICE_FAULT=lost@200` takes the device
//! away at the 200th submission, `memory@50` refuses the 50th buffer, `shader@5` spoils the source of the 5th kernel that is
//! compiled, neither counting work that is done apart, and `picture@5` refuses the 5th buffer of such work; `…*3` does so three
//! times, counting anew after each. Counted over the whole process.

use std::sync::{Mutex, OnceLock};

/// What can be ordered to fail.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Point {
    /// A submission: the device is lost.
    Lost,
    /// A buffer: the device has no memory.
    Memory,
    /// A kernel: its shader does not compile.
    Shader,
    /// A buffer of work that is done apart, as pictures are drawn: the device has no memory.
    Picture,
}

struct Order {
    point: Point,
    /// Fails at this count.
    at: u64,
    /// Failures left, and what was counted since the last.
    state: Mutex<(u32, u64)>,
}

/// Whether it fails here and now.
pub(super) fn strikes(point: Point) -> bool {
    static ORDER: OnceLock<Option<Order>> = OnceLock::new();
    let order = ORDER.get_or_init(|| {
        let text = std::env::var("EFFIGY_TEST_DEVICE_FAULT").ok()?;
        let order = parse(&text);
        assert!(order.is_some(), "EFFIGY_TEST_DEVICE_FAULT is {text:?}, expected for example lost@200 or memory@50*3");
        order
    });
    order.as_ref().is_some_and(|order| order.point == point && order.count())
}

impl Order {
    fn count(&self) -> bool {
        let (left, counted) = &mut *self.state.lock().unwrap();
        *counted += 1;
        let strikes = *left > 0 && *counted == self.at;
        if strikes {
            (*left, *counted) = (*left - 1, 0);
        }
        strikes
    }
}

fn parse(text: &str) -> Option<Order> {
    let (point, count) = text.split_once('@')?;
    let (at, times) = count.split_once('*').unwrap_or((count, "1"));
    let point = match point {
        "lost" => Point::Lost,
        "memory" => Point::Memory,
        "shader" => Point::Shader,
        "picture" => Point::Picture,
        _ => return None,
    };
    Some(Order { point, at: at.parse().ok()?, state: Mutex::new((times.parse().ok()?, 0)) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_order_strikes_at_its_count_and_so_often() {
        let order = parse("memory@3*2").unwrap();
        let strikes: Vec<u32> = (1..10).filter(|_| order.count()).collect();
        assert_eq!((order.point, strikes), (Point::Memory, vec![3, 6]));
        for wrong in ["lost", "fire@3", "lost@", "lost@3*", "lost@x"] {
            assert!(parse(wrong).is_none(), "{wrong}");
        }
    }
}
