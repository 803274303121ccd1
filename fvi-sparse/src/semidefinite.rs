//! Whether a sparse symmetric matrix is positive semidefinite, in time and memory that grow with its entries.

use crate::{Analysis, FactorError, Pattern};

/// Refuses a matrix that is not positive semidefinite beyond rounding of relative size `rounding`.
///
/// A semidefinite matrix becomes definite when its diagonal is raised by the rounding error, and then has a
/// Cholesky factor. Rows without entries are left out.
///
/// # Errors
/// [`FactorError`], with the coordinate of the pivot that is not positive.
pub fn check_positive_semidefinite(
    pattern: &Pattern,
    values: &[f64],
    rounding: f64,
) -> Result<(), FactorError> {
    let mut number = vec![usize::MAX; pattern.size()];
    let mut kept = Vec::new();
    for (row, slots) in pattern.rows().enumerate() {
        if !slots.is_empty() {
            number[row] = kept.len();
            kept.push(row);
        }
    }
    // NaN is kept, and no pivot with it is positive.
    let larger = |most: f64, entry: f64| if most.is_nan() || entry <= most { most } else { entry };
    let largest = values.iter().map(|entry| entry.abs()).fold(0.0, larger);
    if largest == 0.0 {
        return Ok(());
    }
    let lift = largest * rounding * 64.0 * kept.len() as f64;
    let diagonal = |row: usize| pattern.columns()[pattern.row(row)].binary_search(&(row as u32)).is_ok();
    // If no row is left out, all matrices with the pattern share its analysis.
    if kept.len() == pattern.size() && (0..pattern.size()).all(diagonal) {
        let mut lifted = values.to_vec();
        (0..pattern.size()).for_each(|row| lifted[pattern.slot(row, row)] += lift);
        return Analysis::new(pattern).factor(pattern, &lifted).map(|_| ());
    }
    let (mut rows, mut lifted) = (Vec::with_capacity(kept.len()), Vec::with_capacity(values.len()));
    for (new, &row) in kept.iter().enumerate() {
        let slots = pattern.row(row);
        let entries = pattern.columns()[slots.clone()].iter().zip(&values[slots]);
        let mut entries: Vec<(usize, f64)> = entries
            .filter(|&(&column, _)| number[column as usize] != usize::MAX)
            .map(|(&column, &entry)| (number[column as usize], entry))
            .collect();
        match entries.binary_search_by_key(&new, |&(column, _)| column) {
            Ok(place) => entries[place].1 += lift,
            Err(place) => entries.insert(place, (new, lift)),
        }
        lifted.extend(entries.iter().map(|&(_, entry)| entry));
        rows.push(entries.into_iter().map(|(column, _)| column).collect::<Vec<_>>());
    }
    let pattern = Pattern::from_rows(rows);
    match Analysis::new(&pattern).factor(&pattern, &lifted) {
        Ok(_) => Ok(()),
        Err(FactorError::Pivot { pivot, coordinate }) => {
            Err(FactorError::Pivot { pivot, coordinate: kept.get(coordinate).copied().unwrap_or(coordinate) })
        }
        Err(other) => Err(other),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_free_chain_is_semidefinite_and_a_pushed_one_is_not() {
        let pattern = Pattern::new(5, vec![(1, 1), (1, 3), (3, 1), (3, 3)]);
        let chain = [1.0, -1.0, -1.0, 1.0];
        assert_eq!(check_positive_semidefinite(&pattern, &chain, f64::EPSILON), Ok(()));
        assert_eq!(check_positive_semidefinite(&pattern, &[0.0; 4], f64::EPSILON), Ok(()));
        let pushed = [1.0, -1.0, -1.0, 0.999];
        let refused = check_positive_semidefinite(&pattern, &pushed, f64::EPSILON).unwrap_err();
        assert!(matches!(refused, FactorError::Pivot { coordinate: 1 | 3, .. }), "{refused}");
        // A coupling without entries on the diagonal.
        let coupled = Pattern::new(2, vec![(0, 1), (1, 0)]);
        assert!(check_positive_semidefinite(&coupled, &[1.0, 1.0], f64::EPSILON).is_err());
    }
}
