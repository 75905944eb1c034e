use std::{sync::Arc, time::Duration};

use netcord_common::{Clock, MonotonicClock, Stamp};
use rusb::{Context, DeviceHandle, UsbContext};
use thiserror::Error;

use super::{
    access::FeatureAccess,
    clock::ClockReading,
    discovery::{DiscoveryError, Endpoints, discover, endpoints_of},
    genapi::{FeatureError, GenApi, LoadError},
    gencp::{
        Abrm, ControlChannel, ControlPipe, DescriptionError, Memory, MemoryError, PipeError, Sbrm,
        SirmAddress, read_description,
    },
    stream::{FramePlan, PlanError},
};

/// Why a camera cannot be used.
#[derive(Debug, Error)]
pub enum CameraError {
    /// USB could not be looked at.
    #[error(transparent)]
    Discovery(#[from] DiscoveryError),
    /// There is no such camera.
    #[error("no camera with serial number {serial:?} is plugged in; there {found}")]
    NotFound {
        /// What was asked for.
        serial: String,
        /// What there is.
        found: String,
    },
    /// The device cannot be opened.
    #[error("the camera {serial} cannot be opened: {cause}{}", advice(.cause))]
    Open {
        /// Which.
        serial: String,
        /// Why.
        cause: rusb::Error,
    },
    /// A request of USB itself failed.
    #[error("the camera failed while {doing}: {cause}")]
    Usb {
        /// What was being done.
        doing: &'static str,
        /// Why.
        cause: rusb::Error,
    },
    /// It has no stream.
    #[error("the camera has no stream registers")]
    NoStream,
    /// Its registers cannot be accessed.
    #[error(transparent)]
    Memory(#[from] MemoryError),
    /// Its description cannot be had.
    #[error(transparent)]
    Description(#[from] DescriptionError),
    /// Its description cannot be read.
    #[error(transparent)]
    Load(#[from] LoadError),
    /// A feature cannot be read or set.
    #[error(transparent)]
    Feature(#[from] FeatureError),
    /// It demands what cannot be.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// It is set up in a way that cannot be used.
    #[error("{0}")]
    Setup(String),
}

fn advice(cause: &rusb::Error) -> &'static str {
    match cause {
        rusb::Error::Access => "; install the udev rule with `netcord cameras udev`",
        rusb::Error::Busy => "; another program holds it",
        _ => "",
    }
}

impl CameraError {
    /// Whether the camera has gone.
    pub fn is_gone(&self) -> bool {
        match self {
            Self::Usb { cause, .. } | Self::Open { cause, .. } => *cause == rusb::Error::NoDevice,
            Self::Memory(e) => e.is_gone(),
            Self::Description(DescriptionError::Memory(e)) => e.is_gone(),
            Self::Feature(e) => e.is_gone(),
            _ => false,
        }
    }
}

/// The control endpoints over libusb.
#[derive(Debug)]
pub struct UsbPipe {
    handle: Arc<DeviceHandle<Context>>,
    endpoints: Endpoints,
}

fn pipe_error(e: rusb::Error) -> PipeError {
    match e {
        rusb::Error::Timeout => PipeError::TimedOut,
        rusb::Error::Pipe => PipeError::Stalled,
        rusb::Error::NoDevice => PipeError::Gone,
        other => PipeError::Usb(other.to_string()),
    }
}

impl ControlPipe for UsbPipe {
    fn send(&mut self, packet: &[u8], timeout: Duration) -> Result<(), PipeError> {
        self.handle.write_bulk(self.endpoints.control_out, packet, timeout).map(drop).map_err(pipe_error)
    }

    fn receive(&mut self, buffer: &mut [u8], timeout: Duration) -> Result<usize, PipeError> {
        self.handle.read_bulk(self.endpoints.control_in, buffer, timeout).map_err(pipe_error)
    }

    fn clear_halt(&mut self) -> Result<(), PipeError> {
        self.handle.clear_halt(self.endpoints.control_in).map_err(pipe_error)?;
        self.handle.clear_halt(self.endpoints.control_out).map_err(pipe_error)
    }

    fn now(&self) -> Stamp {
        MonotonicClock.now()
    }
}

/// An open camera: its registers and features.
#[derive(Debug)]
pub struct Camera {
    /// The device.
    handle: Arc<DeviceHandle<Context>>,
    endpoints: Endpoints,
    channel: ControlChannel<UsbPipe>,
    api: GenApi,
    description: String,
    abrm: Abrm,
    sirm: SirmAddress,
}

impl FeatureAccess for Camera {
    fn parts(&mut self) -> (&mut GenApi, &mut dyn Memory) {
        (&mut self.api, &mut self.channel)
    }
}

impl Camera {
    /// Opens the camera with a serial number; an empty one opens the only camera there is.
    ///
    /// # Errors
    /// [`CameraError`].
    pub fn open(context: &Context, serial: &str) -> Result<Self, CameraError> {
        let found = discover(context)?.cameras;
        let mut matching =
            found.iter().filter(|c| serial.is_empty() || c.serial == serial || c.guid == serial);
        let (Some(camera), true) = (matching.next(), !serial.is_empty() || found.len() == 1) else {
            let list = found.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
            let found = if list.is_empty() { "is none".to_owned() } else { format!("are {list}") };
            return Err(CameraError::NotFound { serial: serial.to_owned(), found });
        };
        let open = |cause| CameraError::Open { serial: camera.serial.clone(), cause };
        let devices = context.devices().map_err(open)?;
        let device = devices
            .iter()
            .find(|d| (d.bus_number(), d.address()) == camera.place)
            .ok_or_else(|| open(rusb::Error::NoDevice))?;
        let (endpoints, _) = endpoints_of(&device).map_err(CameraError::Setup)?;
        let handle = device.open().map_err(open)?;
        // Not supported everywhere, and no driver is bound to such interfaces by default.
        let _ = handle.set_auto_detach_kernel_driver(true);
        handle.claim_interface(endpoints.control_interface).map_err(open)?;
        handle.claim_interface(endpoints.stream_interface).map_err(open)?;
        Self::with(Arc::new(handle), endpoints)
    }

    fn with(handle: Arc<DeviceHandle<Context>>, endpoints: Endpoints) -> Result<Self, CameraError> {
        let mut pipe = UsbPipe { handle: handle.clone(), endpoints };
        // A dead process may have left an acknowledge half read.
        if let Err(PipeError::Gone) = pipe.clear_halt() {
            return Err(CameraError::Usb {
                doing: "clearing its control endpoints",
                cause: rusb::Error::NoDevice,
            });
        }
        let mut channel = ControlChannel::new(pipe);
        let abrm = Abrm::read(&mut channel)?;
        let sbrm = Sbrm::read(&mut channel, abrm.sbrm)?;
        channel.adopt(&sbrm, abrm.response_ms);
        let sirm = SirmAddress(sbrm.sirm.ok_or(CameraError::NoStream)?);
        let description = read_description(&mut channel, abrm.manifest)?;
        let api = GenApi::load(&description)?;
        Ok(Self { handle, endpoints, channel, api, description, abrm, sirm })
    }

    /// What the camera says of itself.
    pub const fn abrm(&self) -> &Abrm {
        &self.abrm
    }

    /// The description that it brought along.
    pub fn description(&self) -> &str {
        &self.description
    }

    /// Its features by category.
    pub fn features(&self) -> Vec<(String, Vec<String>)> {
        self.api.features()
    }

    /// Reads the device's clock between two stamps of the host's.
    ///
    /// # Errors
    /// [`MemoryError`].
    pub fn read_clock(&mut self) -> Result<ClockReading, MemoryError> {
        let before_ns = MonotonicClock.now().as_ns();
        self.channel.write(0x1F8, &1_u32.to_le_bytes())?;
        let after_ns = MonotonicClock.now().as_ns();
        let mut ticks = [0; 8];
        self.channel.read(0x1F0, &mut ticks)?;
        let device_ns = u64::from_le_bytes(ticks).wrapping_mul(self.abrm.tick_ns.max(1));
        Ok(ClockReading { device_ns, before_ns, after_ns })
    }

    /// How the camera's frames must be cut now.
    ///
    /// # Errors
    /// [`CameraError`].
    pub fn plan(&mut self) -> Result<FramePlan, CameraError> {
        Ok(FramePlan::new(&self.sirm.read(&mut self.channel)?, self.endpoints.stream_packet.into())?)
    }

    /// Stops acquisition and stream, whoever started them: a process that died leaves both on.
    ///
    /// # Errors
    /// [`CameraError`].
    pub fn quiet(&mut self) -> Result<(), CameraError> {
        match self.execute("AcquisitionStop") {
            Err(e) if e.is_gone() => return Err(e.into()),
            // A camera that does not run may refuse to stop.
            _ => {}
        }
        self.lock_parameters(false)?;
        Ok(self.sirm.enable(&mut self.channel, false)?)
    }

    /// Prepares the stream with what `plan` says, up to the point where transfers may be queued.
    ///
    /// # Errors
    /// [`CameraError`].
    pub fn arm(&mut self, plan: &FramePlan) -> Result<(), CameraError> {
        // Setting and clearing the halt brings a camera that was left in the middle of a frame back to
        // the start of one, and both ends' data toggles together.
        const ENDPOINT_HALT: u16 = 0;
        const RECIPIENT_ENDPOINT: u8 = 0x02;
        const SET_FEATURE: u8 = 0x03;
        let endpoint = self.endpoints.stream;
        let timeout = Duration::from_millis(500);
        let usb = |doing| move |cause| CameraError::Usb { doing, cause };
        // Optional for devices, so that other errors pass; clearing is what counts.
        if let Err(cause @ rusb::Error::NoDevice) = self.handle.write_control(
            RECIPIENT_ENDPOINT,
            SET_FEATURE,
            ENDPOINT_HALT,
            endpoint.into(),
            &[],
            timeout,
        ) {
            return Err(CameraError::Usb { doing: "halting its stream endpoint", cause });
        }
        self.handle.clear_halt(endpoint).map_err(usb("clearing its stream endpoint"))?;
        self.sirm.write_sizes(&mut self.channel, &plan.sizes)?;
        Ok(self.sirm.enable(&mut self.channel, true)?)
    }

    /// Starts the acquisition; transfers are queued already.
    ///
    /// # Errors
    /// [`CameraError`].
    pub fn start(&mut self) -> Result<(), CameraError> {
        self.lock_parameters(true)?;
        Ok(self.execute("AcquisitionStart")?)
    }

    fn lock_parameters(&mut self, on: bool) -> Result<(), CameraError> {
        if !self.has("TLParamsLocked") {
            return Ok(());
        }
        match self.set("TLParamsLocked", if on { "1" } else { "0" }) {
            Err(e) if e.is_gone() => Err(e.into()),
            // Some cameras keep it to themselves.
            _ => Ok(()),
        }
    }

    pub(super) fn raw(&self) -> (Arc<DeviceHandle<Context>>, u8) {
        (self.handle.clone(), self.endpoints.stream)
    }
}
