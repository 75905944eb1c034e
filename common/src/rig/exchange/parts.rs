//! What several formats share.

use std::{fmt::Write as _, path::Path};

use nalgebra::{Matrix3, Vector3};

use crate::{
    camera::{CameraModel, Distortion},
    geometry::{Camera, Transform, World},
};

/// What is wrong, as a sentence.
pub(super) type Read<T> = Result<T, String>;

/// A YAML document as `T`; the message of an error names line and column.
pub(super) fn yaml<T: serde::de::DeserializeOwned>(text: &str) -> Read<T> {
    serde_saphyr::from_str(text).map_err(|e| e.to_string())
}

/// A camera's name from a file's: what is not allowed in names becomes `-`.
pub(super) fn name_from(path: &Path) -> String {
    let stem = path.file_stem().map_or_else(String::new, |s| s.to_string_lossy().into_owned());
    let plain = |c: char| if c.is_ascii_alphanumeric() || c == '_' { c } else { '-' };
    let name: String = stem.chars().map(plain).collect();
    let name = name.trim_matches(['-', '_']);
    let name = &name[..name.len().min(crate::name::MAX_NAME_LEN)];
    if name.is_empty() { "camera".into() } else { name.into() }
}

/// K and D as a model. `k` is row-major 3 × 3.
pub(super) fn model(who: &str, size: (u32, u32), k: &[f64], d: &[f64]) -> Read<CameraModel> {
    let [fx, skew, cx, l1, fy, cy, l2, l3, one] = *k else {
        return Err(format!("{who}: the camera matrix has {} numbers; it must have 9", k.len()));
    };
    if skew != 0.0 || l1 != 0.0 || l2 != 0.0 || l3 != 0.0 || one != 1.0 {
        return Err(format!(
            "{who}: the camera matrix must be [fx 0 cx; 0 fy cy; 0 0 1]; a skewed or scaled one is not supported"
        ));
    }
    CameraModel::new(size, (fx, fy), (cx, cy), lens(who, d)?).map_err(|e| format!("{who}: {e}"))
}

/// `k1 k2 p1 p2 [k3 …]`; further coefficients must be zero.
pub(super) fn lens(who: &str, d: &[f64]) -> Read<Distortion> {
    if !matches!(d.len(), 0 | 4 | 5 | 8 | 12 | 14) {
        return Err(format!(
            "{who}: {} distortion coefficients; there must be 5 (k1 k2 p1 p2 k3), or 4 (without k3)",
            d.len()
        ));
    }
    if d.iter().skip(5).any(|c| *c != 0.0) {
        return Err(format!(
            "{who}: the lens has more than the 5 coefficients k1 k2 p1 p2 k3; calibrate it without the rational, \
             thin-prism and tilt terms"
        ));
    }
    let mut five = [0.0; 5];
    five.iter_mut().zip(d).for_each(|(to, from)| *to = *from);
    Ok(Distortion::from_array(five))
}

/// R (row-major) and t as a transform.
pub(super) fn pose(who: &str, r: &[f64], t: &[f64]) -> Read<Transform<Camera, World>> {
    if r.len() != 9 || t.len() != 3 {
        return Err(format!(
            "{who}: the pose has {} numbers of rotation and {} of translation; there must be 9 and 3",
            r.len(),
            t.len()
        ));
    }
    Transform::from_matrix(&Matrix3::from_row_slice(r), Vector3::from_row_slice(t))
        .map_err(|e| format!("{who}: {e}"))
}

/// `[a, b, c]`, each number with all its digits.
pub(super) fn list(values: impl IntoIterator<Item = f64>) -> String {
    let mut text = String::from("[");
    for (i, v) in values.into_iter().enumerate() {
        let comma = if i > 0 { ", " } else { "" };
        // Debug of f64 is the shortest text that reads back as the same number, always with a point.
        let _ = write!(text, "{comma}{v:?}");
    }
    text + "]"
}

/// K, row by row.
pub(super) fn camera_matrix(m: &CameraModel) -> [f64; 9] {
    [m.fx, 0.0, m.cx, 0.0, m.fy, m.cy, 0.0, 0.0, 1.0]
}

/// R, row by row.
pub(super) fn rows(m: &Matrix3<f64>) -> [f64; 9] {
    let t = m.transpose();
    std::array::from_fn(|i| t.as_slice()[i])
}
