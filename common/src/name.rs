//! Names that become parts of service names, file names and topics.

use std::{fmt, str::FromStr};

use serde::{Deserialize, Deserializer, Serialize};
use thiserror::Error;

/// Longest name, in bytes. Names stand in fixed-size messages and in shared-memory file names,
/// which have 255 bytes in all.
pub const MAX_NAME_LEN: usize = 31;

/// A name that breaks the rules of [`CameraName`] and [`DomainName`].
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error(
    "{kind} name {name:?} is not valid: 1 to {MAX_NAME_LEN} characters of a-z, A-Z, 0-9, '_' and '-' are allowed, \
     the first of them a letter or digit"
)]
pub struct NameError {
    kind: &'static str,
    name: String,
}

fn check(kind: &'static str, name: &str) -> Result<(), NameError> {
    let valid = (1..=MAX_NAME_LEN).contains(&name.len())
        && name.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_' || b == b'-')
        && name.as_bytes()[0].is_ascii_alphanumeric();
    if valid { Ok(()) } else { Err(NameError { kind, name: name.to_owned() }) }
}

macro_rules! name_type {
    ($(#[$doc:meta])* $type:ident, $kind:literal) => {
        $(#[$doc])*
        #[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize)]
        #[serde(transparent)]
        pub struct $type(String);

        impl $type {
            /// Checks `name` and wraps it.
            ///
            /// # Errors
            /// [`NameError`] when it is empty, too long, or holds other characters than allowed.
            pub fn new(name: impl Into<String>) -> Result<Self, NameError> {
                let name = name.into();
                check($kind, &name)?;
                Ok(Self(name))
            }

            /// The name as text.
            pub fn as_str(&self) -> &str {
                &self.0
            }
        }

        impl FromStr for $type {
            type Err = NameError;

            fn from_str(name: &str) -> Result<Self, NameError> {
                Self::new(name)
            }
        }

        impl fmt::Display for $type {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(&self.0)
            }
        }

        impl<'de> Deserialize<'de> for $type {
            fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                Self::new(String::deserialize(deserializer)?).map_err(serde::de::Error::custom)
            }
        }
    };
}

name_type!(
    /// The name of a camera in its rig, such as `left`: part of `camera/<name>/frame`.
    CameraName,
    "camera"
);
name_type!(
    /// The name of a domain: processes meet only others of their domain.
    DomainName,
    "domain"
);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_become_parts_of_paths_so_only_plain_characters_pass() {
        for good in ["left", "cam-1", "Cam_02", "7", "a234567890123456789012345678901"] {
            assert_eq!(CameraName::new(good).expect(good).as_str(), good);
        }
        for bad in ["", "a/b", "..", "-x", "_x", "ä", "a b", "a2345678901234567890123456789012"] {
            let error = CameraName::new(bad).expect_err(bad);
            assert!(error.to_string().contains("a-z"), "{error}");
        }
    }
}
