use netcord_common::{
    PixelFormat,
    wire::{
        BallPosition, BallTrajectory, BallTruth, Detection, Detections, FrameHeader, Frameset, Health,
        LandingKind, MethodCode, NoPosition, ProcessState, Scope, SearchWindow, Stamps, TrajectoryOutcome,
        Verdict, WorldFrame,
    },
};
use serde_json::{Value, json};

/// A message's fields under their own names; codes as their names, masks as lists of camera indices.
pub(super) trait AsJson {
    /// A JSON object.
    fn as_json(&self) -> Value;
}

/// The name of a code; a code that this version does not know stays a number.
macro_rules! name {
    ($type:ty, $code:expr) => {
        <$type>::from_code($code).map_or(json!($code), |value| json!(value.name()))
    };
}

/// The cameras whose bits are set.
fn cameras(mask: u32) -> Vec<u32> {
    (0..u32::BITS).filter(|i| mask & (1 << i) != 0).collect()
}

fn stamps(s: &Stamps) -> Value {
    json!({
        "mid_exposure_ns": s.mid_exposure_ns,
        "mid_exposure_host_ns": s.mid_exposure_host_ns,
        "frame_complete_ns": s.frame_complete_ns,
        "frame_published_ns": s.frame_published_ns,
        "segment_start_ns": s.segment_start_ns,
        "segment_published_ns": s.segment_published_ns,
        "triangulate_start_ns": s.triangulate_start_ns,
        "triangulate_published_ns": s.triangulate_published_ns,
        "predict_start_ns": s.predict_start_ns,
        "predict_published_ns": s.predict_published_ns,
    })
}

impl AsJson for FrameHeader {
    fn as_json(&self) -> Value {
        let format = PixelFormat::from_pfnc(self.pixel_format);
        json!({
            "trigger_id": self.trigger_id,
            "sequence": self.sequence,
            "session": self.session,
            "stamps": stamps(&self.stamps),
            "exposure_ns": self.exposure_ns,
            "block_id": self.block_id,
            "gain_db": self.gain_db,
            "width": self.width,
            "height": self.height,
            "stride": self.stride,
            "pixel_format": format.map_or(json!(self.pixel_format), |f| json!(f.to_string())),
            "camera": self.camera,
        })
    }
}

impl AsJson for Detection {
    fn as_json(&self) -> Value {
        json!({
            "u_px": self.u_px,
            "v_px": self.v_px,
            "covariance_px2": self.covariance_px2,
            "box_px": [self.x0_px, self.y0_px, self.x1_px, self.y1_px],
            "diameter_px": self.diameter_px,
            "area_px2": self.area_px2,
            "blur_px": [self.blur_u_px, self.blur_v_px],
            "score": self.score,
            "flags": self.flags,
        })
    }
}

impl AsJson for Detections {
    fn as_json(&self) -> Value {
        json!({
            "trigger_id": self.trigger_id,
            "sequence": self.sequence,
            "session": self.session,
            "stamps": stamps(&self.stamps),
            "exposure_ns": self.exposure_ns,
            "frames_lost": self.frames_lost,
            "camera": self.camera,
            "scope": name!(Scope, self.scope),
            "items": self.items().iter().map(AsJson::as_json).collect::<Vec<_>>(),
        })
    }
}

impl AsJson for SearchWindow {
    fn as_json(&self) -> Value {
        json!({
            "made_from_trigger": self.made_from_trigger,
            "mid_exposure_ns": self.mid_exposure_ns,
            "box_px": [self.x0_px, self.y0_px, self.x1_px, self.y1_px],
            "u_px": self.u_px,
            "v_px": self.v_px,
            "covariance_px2": self.covariance_px2,
            "diameter_px": self.diameter_px,
            "velocity_px_s": self.velocity_px_s,
            "camera": self.camera,
            "present": self.present == 1,
        })
    }
}

impl AsJson for Frameset {
    fn as_json(&self) -> Value {
        let mid = cameras(self.expected).into_iter().map(|i| {
            self.mid_exposure_ns.get(i as usize).filter(|_| self.delivered & (1 << i) != 0).copied()
        });
        json!({
            "trigger_id": self.trigger_id,
            "session": self.session,
            "verdict": name!(Verdict, self.verdict),
            "skew_ns": self.skew_ns,
            "tolerance_ns": self.tolerance_ns,
            "decided_ns": self.decided_ns,
            "expected": cameras(self.expected),
            "delivered": cameras(self.delivered),
            "mid_exposure_ns": mid.collect::<Vec<_>>(),
        })
    }
}

impl AsJson for BallPosition {
    fn as_json(&self) -> Value {
        let mut json = json!({
            "trigger_id": self.trigger_id,
            "sequence": self.sequence,
            "stamps": stamps(&self.stamps),
            "present": self.is_present(),
            "views": cameras(self.views),
            "rejected": cameras(self.rejected),
            "distrusted": cameras(self.distrusted),
            "method": name!(MethodCode, self.method),
            "frame": name!(WorldFrame, self.frame),
            "scope": name!(Scope, self.scope),
        });
        if self.is_present() {
            json["position_m"] = json!(self.position_m);
            json["covariance_m2"] = json!(self.covariance_m2);
            json["residual_px"] = json!(self.residual_px);
            json["chi2"] = json!(self.chi2);
        } else {
            json["reason"] = name!(NoPosition, self.reason);
        }
        json
    }
}

impl AsJson for BallTrajectory {
    fn as_json(&self) -> Value {
        let mut json = json!({
            "trigger_id": self.trigger_id,
            "sequence": self.sequence,
            "stamps": stamps(&self.stamps),
            "outcome": name!(TrajectoryOutcome, self.outcome),
            "frame": name!(WorldFrame, self.frame),
        });
        if self.outcome != TrajectoryOutcome::InFlight.code() {
            return json;
        }
        json["flight_id"] = json!(self.flight_id);
        json["bounces"] = json!(self.bounces);
        json["position_m"] = json!(self.position_m);
        json["velocity_m_s"] = json!(self.velocity_m_s);
        json["spin_rad_s"] = json!(self.spin_rad_s);
        if self.crossing.t_ns != 0 {
            let c = &self.crossing;
            json["crossing"] = json!({
                "t_ns": c.t_ns, "position_m": c.position_m, "velocity_m_s": c.velocity_m_s,
                "covariance_m2": c.covariance_m2, "sigma_t_s": c.sigma_t_s, "confidence": c.confidence,
            });
        }
        if self.landing.t_ns != 0 {
            let l = &self.landing;
            json["landing"] = json!({
                "t_ns": l.t_ns, "position_m": l.position_m, "covariance_m2": l.covariance_m2,
                "sigma_t_s": l.sigma_t_s, "kind": name!(LandingKind, l.kind),
            });
        }
        let path = self.path().iter().map(|p| {
            json!({"t_ns": p.t_ns, "position_m": p.position_m, "covariance_m2": p.covariance_m2, "confidence": p.confidence})
        });
        json["path"] = path.collect();
        json
    }
}

impl AsJson for Health {
    fn as_json(&self) -> Value {
        let counters = self.counters().iter().map(|c| (c.name.as_str().to_owned(), json!(c.value)));
        json!({
            "process": self.process.as_str(),
            "pid": self.pid,
            "state": name!(ProcessState, self.state),
            "started_ns": self.started_ns,
            "now_ns": self.now_ns,
            "counters": counters.collect::<serde_json::Map<_, _>>(),
        })
    }
}

impl AsJson for BallTruth {
    fn as_json(&self) -> Value {
        let mut json = json!({
            "trigger_id": self.trigger_id,
            "mid_exposure_ns": self.mid_exposure_ns,
            "present": self.present == 1,
        });
        if self.present == 1 {
            json["flight_id"] = json!(self.flight_id);
            json["position_m"] = json!(self.position_m);
            json["velocity_m_s"] = json!(self.velocity_m_s);
            json["spin_rad_s"] = json!(self.spin_rad_s);
            let seen = |(i, c): (usize, &netcord_common::wire::CameraTruth)| {
                (c.visible > 0.0)
                    .then(|| json!({"camera": i, "u_px": c.u_px, "v_px": c.v_px, "visible": c.visible}))
            };
            json["cameras"] = self.cameras.iter().enumerate().filter_map(seen).collect();
        }
        json
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_absent_is_absent_in_json_too() {
        let none = BallPosition { reason: NoPosition::OneView.code(), ..BallPosition::default() }.as_json();
        assert_eq!(none["reason"], "OneView");
        assert!(none.get("position_m").is_none());
        let some =
            BallPosition { views: 0b101, position_m: [1.0, 2.0, 3.0], ..BallPosition::default() }.as_json();
        assert_eq!(some["views"], json!([0, 2]));
        assert_eq!(some["position_m"][2], 3.0);
        assert!(BallTrajectory::default().as_json().get("path").is_none());
        let unknown = BallPosition { method: 99, ..BallPosition::default() }.as_json();
        assert_eq!(unknown["method"], 99, "a newer peer's code is shown as it is");
    }
}
