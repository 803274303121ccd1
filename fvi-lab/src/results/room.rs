//! Whether there is room in memory for what a command is about to take.

/// There is not enough memory, or more than this process may take.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("about {} MB of memory are needed, more than there is, or more than may be taken", .bytes.div_ceil(1 << 20))]
pub struct NoRoom {
    /// Bytes that would be needed.
    pub bytes: usize,
}

/// Refuses what cannot be had: an allocation that fails later would end the process without a word.
///
/// The system hands out memory that it may not have, so success promises nothing; a limit on the process is
/// honoured.
///
/// # Errors
/// [`NoRoom`].
pub fn require(bytes: usize) -> Result<(), NoRoom> {
    Vec::<u8>::new().try_reserve_exact(bytes).map_err(|_| NoRoom { bytes })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_nobody_has_is_refused() {
        assert_eq!(require(1 << 20), Ok(()));
        let refused = require(usize::MAX).unwrap_err();
        assert!(refused.to_string().starts_with("about 17592186044416 MB of memory"), "{refused}");
    }
}
