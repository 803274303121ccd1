//! Largest errors that keep what is no number.

/// The larger of two numbers, for folds over errors; NaN if either is NaN, which `f64::max` would leave out.
pub fn larger(largest: f64, number: f64) -> f64 {
    if largest.is_nan() || number <= largest { largest } else { number }
}

#[cfg(test)]
mod tests {
    use super::larger;

    #[test]
    fn what_is_no_number_is_kept_wherever_it_stands() {
        for place in 0..3 {
            let mut errors = [1.0, 3.0, 2.0];
            assert_eq!(errors.into_iter().fold(0.0, larger), 3.0);
            errors[place] = f64::NAN;
            assert!(errors.into_iter().fold(0.0, larger).is_nan(), "{errors:?}");
        }
    }
}
