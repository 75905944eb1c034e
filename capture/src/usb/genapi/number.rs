use std::fmt;

/// A number of GenApi: features are integers of 64 bits or floats.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Number {
    /// An integer.
    Int(i64),
    /// A float.
    Float(f64),
}

impl Number {
    /// As an integer; floats are cut, and held at the ends of the range.
    pub const fn int(self) -> i64 {
        match self {
            Self::Int(i) => i,
            Self::Float(f) => f as i64,
        }
    }

    /// As a float.
    pub const fn float(self) -> f64 {
        match self {
            Self::Int(i) => i as f64,
            Self::Float(f) => f,
        }
    }

    /// Whether it counts as true.
    pub const fn is_true(self) -> bool {
        match self {
            Self::Int(i) => i != 0,
            Self::Float(f) => f != 0.0,
        }
    }

    /// Reads what stands in descriptions and formulas: decimal, hexadecimal (also beyond the sign
    /// bit), floats.
    pub fn parse(text: &str) -> Option<Self> {
        let text = text.trim();
        let (sign, digits) = match text.strip_prefix('-') {
            Some(rest) => (-1, rest),
            None => (1, text.strip_prefix('+').unwrap_or(text)),
        };
        if let Some(hex) = digits.strip_prefix("0x").or_else(|| digits.strip_prefix("0X")) {
            let value = u64::from_str_radix(hex, 16).ok()?.cast_signed();
            return Some(Self::Int(value.wrapping_mul(sign)));
        }
        if let Ok(value) = text.parse::<i64>() {
            return Some(Self::Int(value));
        }
        if let Ok(value) = digits.parse::<u64>() {
            return Some(Self::Int(value.cast_signed().wrapping_mul(sign)));
        }
        let begins = digits.starts_with(|c: char| c.is_ascii_digit() || c == '.');
        text.parse::<f64>().ok().filter(|f| f.is_finite() && begins).map(Self::Float)
    }
}

impl fmt::Display for Number {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Int(i) => i.fmt(f),
            Self::Float(x) => x.fmt(f),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_descriptions() {
        assert_eq!(Number::parse(" 0x10 "), Some(Number::Int(16)));
        assert_eq!(Number::parse("0xFFFFFFFFFFFFFFFF"), Some(Number::Int(-1)));
        assert_eq!(Number::parse("-5"), Some(Number::Int(-5)));
        assert_eq!(Number::parse("18446744073709551615"), Some(Number::Int(-1)));
        assert_eq!(Number::parse("1.5E-3"), Some(Number::Float(0.0015)));
        for bad in ["", "x", "nan", "inf", "1e999", "0xZ", "--1"] {
            assert_eq!(Number::parse(bad), None, "{bad}");
        }
    }
}
