use core::fmt;

use iceoryx2::prelude::ZeroCopySend;

/// Text of at most `N` bytes of UTF-8, padded with zeros.
#[derive(Clone, Copy, PartialEq, Eq, ZeroCopySend)]
#[type_name("netcord.Text")]
#[repr(C)]
pub struct Text<const N: usize> {
    bytes: [u8; N],
}

impl<const N: usize> Text<N> {
    /// The text, cut at the last character that fits.
    pub fn new(text: &str) -> Self {
        let mut end = text.len().min(N);
        while !text.is_char_boundary(end) {
            end -= 1;
        }
        let mut bytes = [0; N];
        bytes[..end].copy_from_slice(&text.as_bytes()[..end]);
        Self { bytes }
    }

    /// The text up to the first zero, or to the first byte that is no UTF-8.
    pub fn as_str(&self) -> &str {
        let end = self.bytes.iter().position(|b| *b == 0).unwrap_or(N);
        match str::from_utf8(&self.bytes[..end]) {
            Ok(text) => text,
            Err(e) => str::from_utf8(&self.bytes[..e.valid_up_to()]).unwrap_or(""),
        }
    }
}

impl<const N: usize> Default for Text<N> {
    fn default() -> Self {
        Self { bytes: [0; N] }
    }
}

impl<const N: usize> fmt::Debug for Text<N> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Debug::fmt(self.as_str(), f)
    }
}

impl<const N: usize> fmt::Display for Text<N> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_cut_between_characters_and_read_up_to_what_is_valid() {
        assert_eq!(Text::<8>::new("left").as_str(), "left");
        assert_eq!(Text::<4>::new("abcdef").as_str(), "abcd");
        assert_eq!(Text::<4>::new("abcä").as_str(), "abc");
        let broken = Text::<4> { bytes: [b'a', 0xff, b'b', 0] };
        assert_eq!(broken.as_str(), "a");
    }
}
