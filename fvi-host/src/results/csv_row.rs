//! Rows of comma-separated numbers.

/// Appends a line with these numbers, each with the fewest digits that restore the same f64.
pub(crate) fn append_row<'a>(text: &mut String, numbers: impl IntoIterator<Item = &'a f64>) {
    let mut digits = zmij::Buffer::new();
    for (index, &number) in numbers.into_iter().enumerate() {
        if index > 0 {
            text.push(',');
        }
        text.push_str(digits.format(number));
    }
    text.push('\n');
}

#[cfg(test)]
mod tests {
    use super::append_row;

    #[test]
    fn every_number_is_restored_from_its_text() {
        let numbers =
            [0.1, -0.0, 1.0, 1.0 / 3.0, 5e-324, f64::MAX, -1e22, 1.5e300, 123_456_789.0, f64::MIN_POSITIVE];
        let mut text = String::new();
        append_row(&mut text, &numbers);
        let read: Vec<f64> = text.trim_end().split(',').map(|cell| cell.parse().unwrap()).collect();
        assert!(read.iter().zip(&numbers).all(|(a, b)| a.to_bits() == b.to_bits()), "{text}");
        assert!(text.starts_with("0.1,-0.0,1.0,0.3333333333333333,5e-324,"), "{text}");
        let mut text = String::new();
        append_row(&mut text, &[f64::NAN, f64::INFINITY, f64::NEG_INFINITY]);
        assert_eq!(text, "NaN,inf,-inf\n");
    }
}
