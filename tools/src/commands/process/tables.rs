use std::{
    fs::File,
    io::{BufWriter, Write as _},
    path::PathBuf,
};

use netcord_common::{
    rig::Rig,
    wire::{BallPosition, BallTrajectory, Detections, MethodCode},
};
use thiserror::Error;

use crate::output::{Output, OutputError};

/// A table of results that cannot be written.
#[derive(Debug, Error)]
pub(super) enum TableError {
    #[error("cannot write the table {path}: {cause}")]
    Row { path: PathBuf, cause: std::io::Error },
    #[error(transparent)]
    Output(#[from] OutputError),
}

/// One CSV file of results. Numbers are written with as many digits as they have, so that reading them
/// gives them back exactly.
#[derive(Debug)]
pub(super) struct Table {
    output: Output,
    out: BufWriter<File>,
}

/// How far ahead predictions are written, ns.
const HORIZON_NS: u64 = 600_000_000;

impl Table {
    pub(super) const POSITIONS: &'static str = "t_ns,x,y,z,sigma_x,sigma_y,sigma_z,residual_px,views,method";
    pub(super) const DETECTIONS: &'static str = "t_ns,camera,u,v,x0,y0,x1,y1,score";
    pub(super) const PREDICTIONS: &'static str = "t_ns_made,t_ns_for,x,y,z";

    /// Begins the table with its header line.
    pub(super) fn begin(output: Output, columns: &str) -> Result<Self, TableError> {
        let mut table = Self { out: BufWriter::new(output.file()?), output };
        table.row(format_args!("{columns}"))?;
        Ok(table)
    }

    /// A row, if there is a position.
    pub(super) fn position(&mut self, position: &BallPosition) -> Result<(), TableError> {
        if !position.is_present() {
            return Ok(());
        }
        let [x, y, z] = position.position_m;
        let sigma = [0, 4, 8].map(|i| position.covariance_m2[i].max(0.0).sqrt());
        let method = MethodCode::from_code(position.method).map_or("unknown", MethodCode::name);
        self.row(format_args!(
            "{},{x},{y},{z},{},{},{},{},{},{method}",
            position.stamps.mid_exposure_ns,
            sigma[0],
            sigma[1],
            sigma[2],
            position.residual_px,
            position.view_count(),
        ))
    }

    /// A row for each candidate.
    pub(super) fn detections(&mut self, rig: &Rig, detections: &Detections) -> Result<(), TableError> {
        let camera = &rig.cameras[detections.camera as usize].name;
        detections.items().iter().try_for_each(|d| {
            self.row(format_args!(
                "{},{camera},{},{},{},{},{},{},{}",
                detections.stamps.mid_exposure_ns,
                d.u_px,
                d.v_px,
                d.x0_px,
                d.y0_px,
                d.x1_px,
                d.y1_px,
                d.score
            ))
        })
    }

    /// A row for each point of the path that was predicted from a position.
    pub(super) fn predictions(&mut self, trajectory: &BallTrajectory) -> Result<(), TableError> {
        let made = trajectory.stamps.mid_exposure_ns;
        let within = |t_ns: u64| t_ns > made && t_ns - made <= HORIZON_NS;
        trajectory.path().iter().filter(|point| within(point.t_ns)).try_for_each(|point| {
            let [x, y, z] = point.position_m;
            self.row(format_args!("{made},{},{x},{y},{z}", point.t_ns))
        })
    }

    /// Writes what waits.
    pub(super) fn finish(mut self) -> Result<(), TableError> {
        let path = self.output.path().to_owned();
        self.out.flush().map_err(|cause| TableError::Row { path, cause })?;
        Ok(self.output.complete()?)
    }

    fn row(&mut self, row: std::fmt::Arguments<'_>) -> Result<(), TableError> {
        let path = || self.output.path().to_owned();
        writeln!(self.out, "{row}").map_err(|cause| TableError::Row { path: path(), cause })
    }
}
