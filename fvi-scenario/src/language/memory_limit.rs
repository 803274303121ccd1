//! Checks that enough memory is there before it is allocated.

/// The memory needed is not available, or exceeds the limit of this process.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("about {} MB of memory are needed, more than there is, or more than may be taken", .bytes.div_ceil(1 << 20))]
pub struct OutOfMemory {
    /// Bytes that would be needed.
    pub bytes: usize,
}

/// Bytes that are there wherever a process runs.
const LITTLE: usize = 1 << 16;

/// Returns an error if `bytes` bytes cannot be allocated, or are more than the system has available; a later
/// failing allocation would abort the process without a message.
///
/// # Errors
/// [`OutOfMemory`].
pub fn check_capacity(bytes: usize) -> Result<(), OutOfMemory> {
    // A limit on the process shows in the reservation, the memory of the machine does not.
    let granted = Vec::<u8>::new().try_reserve_exact(bytes).is_ok();
    // The system takes longer to answer than a short run.
    if granted && bytes <= LITTLE {
        return Ok(());
    }
    if granted && available_memory().is_none_or(|available| bytes <= available) {
        Ok(())
    } else {
        Err(OutOfMemory { bytes })
    }
}

/// Bytes of memory available without swapping, if the operating system reports them.
pub fn available_memory() -> Option<usize> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    available_in(&text)
}

fn available_in(meminfo: &str) -> Option<usize> {
    let line = meminfo.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    let kilobytes: usize = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    kilobytes.checked_mul(1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_nobody_has_is_refused() {
        assert_eq!(check_capacity(1 << 20), Ok(()));
        let refused = check_capacity(usize::MAX).unwrap_err();
        assert!(refused.to_string().starts_with("about 17592186044416 MB of memory"), "{refused}");
    }

    #[test]
    fn the_line_of_available_memory_is_found() {
        let text = "MemTotal:        4030000 kB\nMemFree:          1 kB\nMemAvailable:    2000000 kB\n";
        assert_eq!(available_in(text), Some(2_048_000_000));
        assert_eq!(available_in("MemTotal: 5 kB\n"), None);
    }
}
