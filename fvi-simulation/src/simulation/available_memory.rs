//! Amount of memory available.

/// Bytes of memory available without swapping, if the operating system reports them.
pub(super) fn available_memory() -> Option<usize> {
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
    fn the_line_of_available_memory_is_found() {
        let text = "MemTotal:        4030000 kB\nMemFree:          1 kB\nMemAvailable:    2000000 kB\n";
        assert_eq!(available_in(text), Some(2_048_000_000));
        assert_eq!(available_in("MemTotal: 5 kB\n"), None);
    }
}
