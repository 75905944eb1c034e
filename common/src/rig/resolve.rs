//! The file's tables become a rig, or an error that names file, line and key.

mod cameras;
#[cfg(test)]
mod tests;

use std::{ops::Range, path::Path};

use nalgebra::{Matrix3, Vector3};
use toml::Spanned;

use super::{
    Ball, FlightConstants, HittingPlane, ProcessSpec, Rig, RigError,
    file::{FlightTable, PoseTable, ProcessTable, RigFile},
    system::interval_ns,
};
use crate::{
    geometry::{ReferenceFrame, Transform, World},
    name::DomainName,
    wire::WorldFrame,
};

/// Exposures a second where the file does not say.
const DEFAULT_RATE_HZ: f64 = 100.0;

/// The frame of the rig's first camera, in which the poses of cameras stand in the file.
enum First {}
impl ReferenceFrame for First {}

/// The file being resolved, for errors.
pub(super) struct Source<'a> {
    pub(super) text: &'a str,
    pub(super) path: &'a Path,
}

impl Source<'_> {
    pub(super) fn error(&self, span: Range<usize>, message: impl Into<String>) -> RigError {
        RigError::at(self.path, self.text, span.start, message)
    }

    pub(super) fn resolve(&self, file: &RigFile) -> Result<Rig, RigError> {
        let name = DomainName::new(file.name.get_ref())
            .map_err(|e| self.error(file.name.span(), format!("name: {e}")))?;
        let rate_hz =
            self.within("rate_hz", file.rate_hz.as_ref(), 0.1..=10_000.0)?.unwrap_or(DEFAULT_RATE_HZ);
        let half_interval_us = interval_ns(rate_hz) as f64 * 0.5e-3;
        let tolerance_us = self
            .within("tolerance_us", file.tolerance_us.as_ref(), 0.0..=half_interval_us)?
            .unwrap_or(half_interval_us);
        let diameter = self.within("ball.diameter_m", file.ball.diameter_m.as_ref(), 0.005..=0.5)?;
        let table = file.table.as_ref().map(|t| self.pose::<First, World>("table", t)).transpose()?;
        Ok(Rig {
            name,
            rate_hz,
            tolerance_ns: (tolerance_us * 1e3).round() as u64,
            ball: Ball {
                diameter_m: diameter.unwrap_or(Ball::default().diameter_m),
                colour: file.ball.colour,
            },
            world: if table.is_some() { WorldFrame::Table } else { WorldFrame::FirstCamera },
            cameras: self.cameras(&file.camera, table.unwrap_or_else(Transform::identity))?,
            flight: self.flight(&file.flight)?,
            hitting_plane: self
                .within("flight.hitting_plane_y_m", file.flight.hitting_plane_y_m.as_ref(), -10.0..=10.0)?
                .map_or_else(HittingPlane::default, |y_m| HittingPlane { y_m }),
            processes: self.processes(&file.process)?,
        })
    }

    fn within(
        &self,
        key: &str,
        value: Option<&Spanned<f64>>,
        range: std::ops::RangeInclusive<f64>,
    ) -> Result<Option<f64>, RigError> {
        let Some(value) = value else { return Ok(None) };
        if range.contains(value.get_ref()) {
            return Ok(Some(*value.get_ref()));
        }
        let (low, high) = (range.start(), range.end());
        Err(self
            .error(value.span(), format!("{key} is {}; it must be from {low} to {high}", value.get_ref())))
    }

    fn pose<To: ReferenceFrame, From: ReferenceFrame>(
        &self,
        what: &str,
        pose: &PoseTable,
    ) -> Result<Transform<To, From>, RigError> {
        let rotation = Matrix3::from_row_slice(pose.rotation.get_ref());
        Transform::from_matrix(&rotation, Vector3::from(pose.translation_m))
            .map_err(|e| self.error(pose.rotation.span(), format!("{what}: {e}")))
    }

    fn flight(&self, table: &FlightTable) -> Result<FlightConstants, RigError> {
        let d = FlightConstants::default();
        let get = |key: &str, value: &Option<Spanned<f64>>, default: f64, range| {
            Ok::<_, RigError>(
                self.within(&format!("flight.{key}"), value.as_ref(), range)?.unwrap_or(default),
            )
        };
        Ok(FlightConstants {
            mass_kg: get("mass_kg", &table.mass_kg, d.mass_kg, 1e-4..=1.0)?,
            gravity_m_s2: get("gravity_m_s2", &table.gravity_m_s2, d.gravity_m_s2, 0.0..=20.0)?,
            drag: get("drag", &table.drag, d.drag, 0.0..=2.0)?,
            drag_induced: get("drag_induced", &table.drag_induced, d.drag_induced, 0.0..=10.0)?,
            magnus: get("magnus", &table.magnus, d.magnus, -1.0..=2.0)?,
            magnus_saturation: get(
                "magnus_saturation",
                &table.magnus_saturation,
                d.magnus_saturation,
                0.0..=20.0,
            )?,
            air_density_kg_m3: get(
                "air_density_kg_m3",
                &table.air_density_kg_m3,
                d.air_density_kg_m3,
                0.0..=2.0,
            )?,
            restitution: get("restitution", &table.restitution, d.restitution, 0.0..=1.0)?,
            restitution_slope_s_m: get(
                "restitution_slope_s_m",
                &table.restitution_slope_s_m,
                d.restitution_slope_s_m,
                0.0..=0.1,
            )?,
            friction: get("friction", &table.friction, d.friction, 0.0..=2.0)?,
        })
    }

    fn processes(&self, tables: &[Spanned<ProcessTable>]) -> Result<Vec<ProcessSpec>, RigError> {
        const COMMANDS: [&str; 7] =
            ["capture", "segment", "triangulate", "predict", "record", "view", "listen"];
        if tables.is_empty() {
            return Ok(ProcessSpec::stages());
        }
        tables
            .iter()
            .map(|spanned| {
                let t = spanned.get_ref();
                if !COMMANDS.contains(&t.command.as_str()) {
                    let valid = COMMANDS.join(", ");
                    let message = format!("process command {:?} is not known; valid are {valid}", t.command);
                    return Err(self.error(spanned.span(), message));
                }
                if t.priority.is_some_and(|p| !(1..=99).contains(&p)) {
                    return Err(self.error(spanned.span(), "process priority must be from 1 to 99"));
                }
                Ok(ProcessSpec {
                    command: t.command.clone(),
                    args: t.args.clone(),
                    affinity: t.affinity.clone(),
                    priority: t.priority,
                    restart: t.restart,
                })
            })
            .collect()
    }
}
