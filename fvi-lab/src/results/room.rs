//! Check that enough memory is available before a command allocates it.

/// The memory needed is not available, or exceeds the limit of this process.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("about {} MB of memory are needed, more than there is, or more than may be taken", .bytes.div_ceil(1 << 20))]
pub struct NoRoom {
    /// Bytes that would be needed.
    pub bytes: usize,
}

/// Returns an error if `bytes` bytes cannot be allocated; a later failing allocation would abort the process
/// without a message.
///
/// Systems may grant more memory than they have, so success guarantees nothing; a limit on the process is
/// respected.
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
