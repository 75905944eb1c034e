use thiserror::Error;

/// Why there is no calibration.
#[derive(Debug, Error)]
pub enum CalibrationError {
    /// The corner file is no such JSON.
    #[error("the corner file does not fit {{\"cameras\": {{NAME: {{\"size\", \"views\"}}}}}}")]
    CornerFile(#[source] serde_json::Error),
    /// Nothing to calibrate.
    #[error("there is no camera to calibrate")]
    NoCameras,
    /// An image without pixels.
    #[error("camera {camera}: an image size of zero; it must be [width, height] in pixels")]
    EmptyImage {
        /// The camera.
        camera: String,
    },
    /// Object and image points do not pair up.
    #[error(
        "camera {camera}, view {view}: {object} object points but {image} image points; they must pair up"
    )]
    Unpaired {
        /// The camera.
        camera: String,
        /// The view.
        view: String,
        /// Object points.
        object: usize,
        /// Image points.
        image: usize,
    },
    /// Corners and their motion do not pair up.
    #[error(
        "camera {camera}, view {view}: {motion} motions but {image} image points; there is one for each, or none"
    )]
    UnpairedMotion {
        /// The camera.
        camera: String,
        /// The view.
        view: String,
        /// Motions.
        motion: usize,
        /// Image points.
        image: usize,
    },
    /// A coordinate is infinite or not a number.
    #[error("camera {camera}, view {view}: a coordinate is not a finite number")]
    NotFinite {
        /// The camera.
        camera: String,
        /// The view.
        view: String,
    },
    /// Not enough views.
    #[error(
        "camera {camera}: too few usable views: {found}; at least {needed} that differ from each other are needed, \
         better 10 to 30 at many tilts"
    )]
    TooFewViews {
        /// The camera.
        camera: String,
        /// Views with at least four points in a plane.
        found: usize,
        /// Views needed.
        needed: usize,
    },
    /// Fewer equations than unknowns.
    #[error("camera {camera}: {equations} coordinates measured for {unknowns} unknowns; take more views")]
    Underdetermined {
        /// The camera.
        camera: String,
        /// Measured coordinates.
        equations: usize,
        /// Unknowns.
        unknowns: usize,
    },
    /// All views show the board alike.
    #[error(
        "camera {camera}: all views show the board at the same tilt (they differ by {spread_deg:.1}°), which leaves \
         the focal length undetermined; tilt the board by 20° to 45° in different directions"
    )]
    Alike {
        /// The camera.
        camera: String,
        /// Largest angle between the boards' normals in two views.
        spread_deg: f64,
    },
    /// Some unknown is not determined.
    #[error(
        "camera {camera}: {parameter} is not determined by these views (standard deviation {sd:.3}); {advice}"
    )]
    Undetermined {
        /// The camera.
        camera: String,
        /// The unknown.
        parameter: &'static str,
        /// Its standard deviation.
        sd: f64,
        /// What would help.
        advice: &'static str,
    },
    /// The iteration came to no end.
    #[error(
        "camera {camera}: the calibration did not converge (RMS {rms_px:.2} px); most likely corners are mixed up or \
         the board's size is wrong"
    )]
    NotConverged {
        /// The camera or cameras.
        camera: String,
        /// RMS where it stopped.
        rms_px: f64,
    },
    /// A point of a view that the solved camera cannot see.
    #[error(
        "camera {camera}, view {view}: a corner lies where the lens found has no image; most likely corners of \
         this view are mixed up: leave it out"
    )]
    NoImage {
        /// The camera.
        camera: String,
        /// The view.
        view: String,
    },
    /// Cameras without common views.
    #[error(
        "camera {camera} shares no usable view with {others}, not even through other cameras: show one board to \
         both at once"
    )]
    NotConnected {
        /// The camera that is alone.
        camera: String,
        /// The connected ones.
        others: String,
    },
    /// Too few cameras.
    #[error("too few cameras: {found}; {needed} are needed")]
    CameraCount {
        /// Cameras given.
        found: usize,
        /// What would be right.
        needed: &'static str,
    },
}
