//! What a mask's bytes mean, everywhere: in masks that are sent, in those of a fit's frames, in the coverage of a picture.

/// Whether a pixel is the person.
pub const fn is_foreground(value: u8) -> bool {
    value >= 128
}

/// Whether a pixel is certainly not the person: what compression leaves of black lies below.
pub const fn is_black(value: u8) -> bool {
    value < 32
}

/// The value without what lies between: 255 for the person, 0 for all else.
pub const fn binary(value: u8) -> u8 {
    if is_foreground(value) { 255 } else { 0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_is_the_person() {
        assert_eq!([0, 127, 128, 255].map(is_foreground), [false, false, true, true]);
        assert_eq!([0, 127, 128, 255].map(binary), [0, 0, 255, 255]);
    }
}
