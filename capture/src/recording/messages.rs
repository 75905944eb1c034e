//! The fields of our recorded messages. Numbers stay for ever: what is new gets a new one.

use netcord_common::wire::{
    BallPosition, BallTrajectory, Detection, Detections, FrameHeader, Landing, LandingKind, MethodCode,
    NoPosition, PathPoint, PlaneCrossing, Scope, Stamps, TrajectoryOutcome, WorldFrame,
};

use super::fields::{Names, Recorded, Visitor};

macro_rules! names {
    ($type:ident) => {
        || -> Names { $type::ALL.iter().map(|v| (v.name().to_owned(), v.code())).collect() }
    };
    (0 = $zero:literal, $type:ident) => {
        || -> Names {
            let others = $type::ALL.iter().map(|v| (v.name().to_owned(), v.code()));
            std::iter::once(($zero.to_owned(), 0)).chain(others).collect()
        }
    };
}

impl Recorded for Stamps {
    const NAME: &'static str = "Stamps";

    fn fields<V: Visitor>(&mut self, v: &mut V) {
        v.unsigned(1, "mid_exposure_ns", &mut self.mid_exposure_ns);
        v.unsigned(2, "mid_exposure_host_ns", &mut self.mid_exposure_host_ns);
        v.unsigned(3, "frame_complete_ns", &mut self.frame_complete_ns);
        v.unsigned(4, "frame_published_ns", &mut self.frame_published_ns);
        v.unsigned(5, "segment_start_ns", &mut self.segment_start_ns);
        v.unsigned(6, "segment_published_ns", &mut self.segment_published_ns);
        v.unsigned(7, "triangulate_start_ns", &mut self.triangulate_start_ns);
        v.unsigned(8, "triangulate_published_ns", &mut self.triangulate_published_ns);
        v.unsigned(9, "predict_start_ns", &mut self.predict_start_ns);
        v.unsigned(10, "predict_published_ns", &mut self.predict_published_ns);
    }
}

impl Recorded for FrameHeader {
    const NAME: &'static str = "FrameHeader";

    fn fields<V: Visitor>(&mut self, v: &mut V) {
        v.unsigned(1, "trigger_id", &mut self.trigger_id);
        v.unsigned(2, "sequence", &mut self.sequence);
        v.unsigned(3, "session", &mut self.session);
        v.message(4, "stamps", &mut self.stamps);
        v.unsigned(5, "exposure_ns", &mut self.exposure_ns);
        v.unsigned(6, "block_id", &mut self.block_id);
        v.double(7, "gain_db", &mut self.gain_db);
        v.small(8, "width", &mut self.width);
        v.small(9, "height", &mut self.height);
        v.small(10, "stride", &mut self.stride);
        v.small(11, "pixel_format", &mut self.pixel_format);
        v.small(12, "camera", &mut self.camera);
    }
}

impl Recorded for Detection {
    const NAME: &'static str = "Detection";

    fn fields<V: Visitor>(&mut self, v: &mut V) {
        v.double(1, "u_px", &mut self.u_px);
        v.double(2, "v_px", &mut self.v_px);
        v.doubles(3, "covariance_px2", &mut self.covariance_px2);
        v.double(4, "x0_px", &mut self.x0_px);
        v.double(5, "y0_px", &mut self.y0_px);
        v.double(6, "x1_px", &mut self.x1_px);
        v.double(7, "y1_px", &mut self.y1_px);
        v.double(8, "diameter_px", &mut self.diameter_px);
        v.double(9, "area_px2", &mut self.area_px2);
        v.double(10, "blur_u_px", &mut self.blur_u_px);
        v.double(11, "blur_v_px", &mut self.blur_v_px);
        v.double(12, "score", &mut self.score);
        v.small(13, "flags", &mut self.flags);
    }
}

impl Recorded for Detections {
    const NAME: &'static str = "Detections";

    fn fields<V: Visitor>(&mut self, v: &mut V) {
        v.unsigned(1, "trigger_id", &mut self.trigger_id);
        v.unsigned(2, "sequence", &mut self.sequence);
        v.unsigned(3, "session", &mut self.session);
        v.message(4, "stamps", &mut self.stamps);
        v.unsigned(5, "exposure_ns", &mut self.exposure_ns);
        v.unsigned(6, "frames_lost", &mut self.frames_lost);
        v.small(7, "camera", &mut self.camera);
        v.code(8, "scope", "Scope", names!(Scope), &mut self.scope);
        v.list(9, "items", &mut self.items, &mut self.count);
    }
}

impl Recorded for BallPosition {
    const NAME: &'static str = "BallPosition";

    fn fields<V: Visitor>(&mut self, v: &mut V) {
        v.unsigned(1, "trigger_id", &mut self.trigger_id);
        v.unsigned(2, "sequence", &mut self.sequence);
        v.message(3, "stamps", &mut self.stamps);
        v.doubles(4, "position_m", &mut self.position_m);
        v.doubles(5, "covariance_m2", &mut self.covariance_m2);
        v.double(6, "residual_px", &mut self.residual_px);
        v.doubles(7, "residual_by_camera_px", &mut self.residual_by_camera_px);
        v.double(8, "chi2", &mut self.chi2);
        v.small(9, "views", &mut self.views);
        v.small(10, "rejected", &mut self.rejected);
        v.bytes(11, "candidate", &mut self.candidate);
        v.code(12, "reason", "NoPosition", names!(0 = "position", NoPosition), &mut self.reason);
        v.code(13, "method", "MethodCode", names!(MethodCode), &mut self.method);
        v.code(14, "frame", "WorldFrame", names!(WorldFrame), &mut self.frame);
        v.code(15, "scope", "Scope", names!(Scope), &mut self.scope);
        v.small(16, "distrusted", &mut self.distrusted);
    }
}

impl Recorded for PathPoint {
    const NAME: &'static str = "PathPoint";

    fn fields<V: Visitor>(&mut self, v: &mut V) {
        v.unsigned(1, "t_ns", &mut self.t_ns);
        v.doubles(2, "position_m", &mut self.position_m);
        v.doubles(3, "covariance_m2", &mut self.covariance_m2);
        v.double(4, "confidence", &mut self.confidence);
    }
}

impl Recorded for PlaneCrossing {
    const NAME: &'static str = "PlaneCrossing";

    fn fields<V: Visitor>(&mut self, v: &mut V) {
        v.unsigned(1, "t_ns", &mut self.t_ns);
        v.doubles(2, "position_m", &mut self.position_m);
        v.doubles(3, "velocity_m_s", &mut self.velocity_m_s);
        v.doubles(4, "covariance_m2", &mut self.covariance_m2);
        v.double(5, "sigma_t_s", &mut self.sigma_t_s);
        v.double(6, "confidence", &mut self.confidence);
    }
}

impl Recorded for Landing {
    const NAME: &'static str = "Landing";

    fn fields<V: Visitor>(&mut self, v: &mut V) {
        v.unsigned(1, "t_ns", &mut self.t_ns);
        v.doubles(2, "position_m", &mut self.position_m);
        v.doubles(3, "covariance_m2", &mut self.covariance_m2);
        v.double(4, "sigma_t_s", &mut self.sigma_t_s);
        v.code(5, "kind", "LandingKind", names!(LandingKind), &mut self.kind);
    }
}

impl Recorded for BallTrajectory {
    const NAME: &'static str = "BallTrajectory";

    fn fields<V: Visitor>(&mut self, v: &mut V) {
        v.unsigned(1, "trigger_id", &mut self.trigger_id);
        v.unsigned(2, "sequence", &mut self.sequence);
        v.message(3, "stamps", &mut self.stamps);
        v.unsigned(4, "flight_id", &mut self.flight_id);
        v.doubles(5, "position_m", &mut self.position_m);
        v.doubles(6, "velocity_m_s", &mut self.velocity_m_s);
        v.doubles(7, "spin_rad_s", &mut self.spin_rad_s);
        v.doubles(8, "covariance", &mut self.covariance);
        v.message(9, "crossing", &mut self.crossing);
        v.message(10, "landing", &mut self.landing);
        v.list(11, "path", &mut self.path, &mut self.path_len);
        v.code(12, "outcome", "TrajectoryOutcome", names!(TrajectoryOutcome), &mut self.outcome);
        v.code(13, "frame", "WorldFrame", names!(WorldFrame), &mut self.frame);
        v.small(14, "bounces", &mut self.bounces);
    }
}

#[cfg(test)]
mod tests {
    use prost::Message as _;
    use prost_types::FileDescriptorSet;

    use super::*;
    use crate::recording::fields::{decode, describe, encode};

    #[test]
    fn messages_come_back_as_they_were() {
        let mut position = BallPosition { trigger_id: 7, views: 3, ..BallPosition::default() };
        position.position_m = [0.1, -0.2, -0.0];
        position.candidate = [255; 16];
        position.stamps.mid_exposure_ns = u64::MAX;
        assert_eq!(decode::<BallPosition>(&encode(&position)), Ok(position));

        let mut trajectory = BallTrajectory { path_len: 2, ..BallTrajectory::default() };
        trajectory.path[1].position_m = [1.0, 2.0, 3.0];
        trajectory.landing.kind = LandingKind::Net.code();
        trajectory.covariance[80] = 1e-9;
        assert_eq!(decode::<BallTrajectory>(&encode(&trajectory)), Ok(trajectory));

        let mut detections = Detections::default();
        detections.insert(Detection { u_px: 5.5, score: 0.5, ..Detection::default() });
        assert_eq!(decode::<Detections>(&encode(&detections)), Ok(detections));
        let header = FrameHeader { gain_db: -1.5, block_id: 9, ..FrameHeader::default() };
        assert_eq!(decode::<FrameHeader>(&encode(&header)), Ok(header));
    }

    #[test]
    fn descriptions_hold_each_type_once_and_enumerations_begin_with_zero() {
        let set = FileDescriptorSet::decode(&*describe::<BallTrajectory>()).expect("valid");
        let file = &set.file[0];
        let names = file.message_type.iter().map(|m| m.name()).collect::<Vec<_>>();
        assert_eq!(names, ["BallTrajectory", "Landing", "PathPoint", "PlaneCrossing", "Stamps"]);
        for described in &file.enum_type {
            assert_eq!(described.value[0].number, Some(0), "{}", described.name());
        }
        let set = FileDescriptorSet::decode(&*describe::<BallPosition>()).expect("valid");
        let reasons = set.file[0].enum_type.iter().find(|e| e.name() == "NoPosition").expect("described");
        assert_eq!(reasons.value[1].name(), "NO_POSITION_NO_DETECTION");
    }
}
