use std::collections::VecDeque;

use crate::{
    CameraConfig, Fault, FaultPlan, ImageSource, InEndpoint, LinkSpeed, Shot, StampAt, Victim, control,
    description::{description, sha1, zipped},
    frame::{Cut, transfers},
    registers::{Registers, at},
};

/// A change of one of the camera's output lines.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Edge {
    /// Which line.
    pub line: u32,
    /// Whether it rose.
    pub rising: bool,
    /// When, emulator's clock, ns.
    pub at_ns: u64,
}

#[derive(Debug, Clone, Copy)]
enum Event {
    FreeRun,
    Expose,
    ExposureEnd,
    ReadOut(Shot),
}

/// An emulated camera. It does nothing by itself: it is told the instant, and gives the instant of its
/// next event.
pub struct Camera {
    config: CameraConfig,
    registers: Registers,
    images: Box<dyn ImageSource>,
    faults: FaultPlan,
    replies: VecDeque<(u64, Vec<u8>)>,
    last_reply: Vec<u8>,
    events: Vec<(u64, Event)>,
    edges: Vec<Edge>,
    /// The stream's endpoint.
    pub stream: InEndpoint,
    acquiring: bool,
    exposing_until: u64,
    block: u64,
    frames: u64,
    commands: u64,
    triggers: u64,
    missed_triggers: u64,
    dropped: u64,
    stalled_control: bool,
    unplug: bool,
}

impl std::fmt::Debug for Camera {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Camera").field("serial", &self.config.serial).field("block", &self.block).finish()
    }
}

impl Camera {
    /// A camera as after power-on.
    pub fn new(config: CameraConfig, images: Box<dyn ImageSource>) -> Self {
        let packet = config.speed.packet();
        let mut camera = Self {
            registers: power_on(&config),
            faults: config.faults.clone(),
            acquiring: config.left_enabled,
            config,
            images,
            replies: VecDeque::new(),
            last_reply: Vec::new(),
            events: Vec::new(),
            edges: Vec::new(),
            stream: InEndpoint::new(packet),
            exposing_until: 0,
            block: 0,
            frames: 0,
            commands: 0,
            triggers: 0,
            missed_triggers: 0,
            dropped: 0,
            stalled_control: false,
            unplug: false,
        };
        camera.required_sizes();
        if camera.config.left_enabled {
            camera.registers.set_u32(at::SIRM_CONTROL, 1);
            camera.registers.set_u32(at::SIRM_PAYLOAD_SIZE, 1 << 20);
            camera.registers.set_u32(at::SIRM_PAYLOAD_COUNT, 2);
            camera.registers.set_u32(at::TL_PARAMS_LOCKED, 1);
            camera.schedule(0, Event::FreeRun);
        }
        camera
    }

    /// What it is.
    pub const fn config(&self) -> &CameraConfig {
        &self.config
    }

    /// Exposures so far.
    pub const fn blocks(&self) -> u64 {
        self.block
    }

    /// Triggers that came while it exposed.
    pub const fn missed_triggers(&self) -> u64 {
        self.missed_triggers
    }

    /// Frames that its memory had no place for.
    pub const fn dropped(&self) -> u64 {
        self.dropped
    }

    /// Sets the faults; frames, commands and triggers are counted from now.
    pub fn set_faults(&mut self, plan: FaultPlan) {
        self.faults = plan;
        self.frames = 0;
        self.commands = 0;
        self.triggers = 0;
    }

    /// Whether the plan has unplugged it; reading this plugs it in again, as after power-on.
    pub fn take_unplug(&mut self) -> bool {
        if !self.unplug {
            return false;
        }
        let config =
            CameraConfig { faults: FaultPlan::default(), left_enabled: false, ..self.config.clone() };
        let images = std::mem::replace(&mut self.images, Box::new(crate::PatternImages));
        *self = Self::new(config, images);
        true
    }

    pub(crate) const fn offers_stacked(&self) -> bool {
        self.config.stacked
    }

    // ---- control endpoint -------------------------------------------------------------------------

    /// A packet on the control endpoint.
    pub fn command(&mut self, packet: &[u8], now: u64) {
        let Some(command) = control::parse(packet) else { return };
        self.commands += 1;
        let fault = self.faults.strikes(Victim::Command, self.commands);
        let reply = control::answer(self, &command, now);
        let mut due = now;
        match fault {
            Some(Fault::LoseAck) => return,
            Some(Fault::StallControl) => {
                self.stalled_control = true;
                return;
            }
            Some(Fault::LateAck(ms)) => due += u64::from(ms) * 1_000_000,
            Some(Fault::StaleAck) => self.replies.push_back((now, self.last_reply.clone())),
            Some(Fault::PendingAck(ms)) => {
                let asked = u16::try_from(ms * 3).unwrap_or(u16::MAX).to_le_bytes();
                let pending = control::ack(0, 0x0805, command.request, &[0, 0, asked[0], asked[1]]);
                self.replies.push_back((now, pending));
                due += u64::from(ms) * 1_000_000;
            }
            _ => {}
        }
        self.last_reply = reply.clone();
        self.replies.push_back((due, reply));
    }

    /// The next acknowledge that is due.
    pub fn reply(&mut self, now: u64) -> Option<Vec<u8>> {
        let at = self.replies.iter().position(|(due, _)| *due <= now)?;
        self.replies.remove(at).map(|(_, reply)| reply)
    }

    /// Whether the control endpoint is halted.
    pub const fn control_stalled(&self) -> bool {
        self.stalled_control
    }

    /// Ends the control endpoint's halt.
    pub fn clear_control_halt(&mut self) {
        self.stalled_control = false;
    }

    /// Ends the stream endpoint's halt; the frame that was under way is thrown away.
    pub fn clear_stream_halt(&mut self) {
        self.stream.clear_halt();
        self.stream.flush();
    }

    fn device_clock(&self, now: u64) -> u64 {
        self.config.clock_offset_ns + now + (now as f64 * self.config.clock_ppm * 1e-6) as u64
    }

    pub(crate) fn read(&mut self, address: u64, length: usize) -> Result<Vec<u8>, u16> {
        if matches!(address, at::ACQUISITION_START | at::TRIGGER_SOFTWARE) {
            // A command that has been carried out reads as 0.
            self.registers.set_u32(address, 0);
        }
        self.registers.read(address, length).map(<[u8]>::to_vec).ok_or(0x8003)
    }

    pub(crate) fn write(&mut self, address: u64, data: &[u8], now: u64) -> Result<(), u16> {
        const READ_ONLY: [u64; 3] = [at::PAYLOAD_SIZE, at::SENSOR_WIDTH, at::SENSOR_HEIGHT];
        const LOCKED: [u64; 3] = [at::WIDTH, at::HEIGHT, at::PIXEL_FORMAT];
        let streaming = self.registers.u32(at::SIRM_CONTROL) & 1 != 0;
        if (at::XML..at::FEATURES).contains(&address) || address < at::USER_ID || READ_ONLY.contains(&address)
        {
            return Err(0x8004);
        }
        if LOCKED.contains(&address) && self.registers.u32(at::TL_PARAMS_LOCKED) != 0 {
            return Err(0x8006);
        }
        if (at::SIRM_MAX_LEADER..=at::SIRM_MAX_TRAILER).contains(&address) && streaming {
            return Err(0x8004);
        }
        let value = data.try_into().map_or(0, u32::from_le_bytes);
        if address == at::SIRM_CONTROL && value & 1 != 0 {
            self.may_enable()?;
        }
        if !self.registers.write(address, data) {
            return Err(0x8003);
        }
        match address {
            at::SIRM_CONTROL if value & 1 == 0 => {
                self.stream.flush();
            }
            at::WIDTH | at::HEIGHT | at::PIXEL_FORMAT => self.required_sizes(),
            at::ACQUISITION_START => {
                self.acquiring = true;
                if !self.trigger_mode() {
                    self.schedule(now, Event::FreeRun);
                }
            }
            at::ACQUISITION_STOP => {
                self.acquiring = false;
                self.events.retain(|(_, e)| matches!(e, Event::ExposureEnd));
            }
            at::TRIGGER_SOFTWARE if self.trigger_mode() && self.trigger_source() == 0 => self.trigger(now),
            at::CLOCK_LATCH => self.registers.set_u64(at::CLOCK, self.device_clock(now)),
            at::TIMESTAMP_LATCH => self.registers.set_u64(at::TIMESTAMP_VALUE, self.device_clock(now)),
            at::FAULTS => {
                let end = data.iter().position(|b| *b == 0).unwrap_or(data.len());
                let text = String::from_utf8_lossy(&data[..end]).into_owned();
                self.set_faults(text.parse().map_err(|_| 0x8002_u16)?);
            }
            _ => {}
        }
        Ok(())
    }

    /// The sizes that the host chose, as the device checks them when the stream is switched on.
    fn may_enable(&self) -> Result<(), u16> {
        if self.stream.is_halted() {
            return Err(0xA002);
        }
        let size = |address| self.registers.u32(address);
        let align = 1_u32 << self.config.alignment();
        let sizes = [at::SIRM_PAYLOAD_SIZE, at::SIRM_FINAL_1, at::SIRM_FINAL_2].map(size);
        if sizes.iter().any(|s| s % align != 0) {
            return Err(0xA003);
        }
        let total = u64::from(sizes[0]) * u64::from(size(at::SIRM_PAYLOAD_COUNT))
            + u64::from(sizes[1])
            + u64::from(sizes[2]);
        let fits = total >= self.registers.u64(at::SIRM_REQUIRED_PAYLOAD)
            && size(at::SIRM_MAX_LEADER) >= 52
            && size(at::SIRM_MAX_TRAILER) >= 32;
        if fits { Ok(()) } else { Err(0xA004) }
    }

    fn required_sizes(&mut self) {
        let r = &mut self.registers;
        let bits = u64::from((r.u32(at::PIXEL_FORMAT) >> 16) & 0xff);
        let bytes = u64::from(r.u32(at::WIDTH)) * u64::from(r.u32(at::HEIGHT)) * bits / 8;
        r.set_u64(at::SIRM_REQUIRED_PAYLOAD, bytes);
        r.set_u32(at::PAYLOAD_SIZE, u32::try_from(bytes).unwrap_or(u32::MAX));
    }

    // ---- exposures --------------------------------------------------------------------------------

    fn trigger_mode(&self) -> bool {
        self.registers.u32(at::TRIGGER) & 0xf == 1
    }

    fn trigger_source(&self) -> u32 {
        (self.registers.u32(at::TRIGGER) >> 4) & 0xf
    }

    fn exposure_ns(&self) -> u64 {
        u64::from(self.registers.u32(at::EXPOSURE)) * 100
    }

    fn schedule(&mut self, at_ns: u64, event: Event) {
        self.events.push((at_ns, event));
    }

    fn trigger(&mut self, now: u64) {
        if !self.acquiring {
            return;
        }
        self.triggers += 1;
        if self.faults.strikes(Victim::Trigger, self.triggers) == Some(Fault::MissTrigger) {
            return;
        }
        let delay = (self.registers.f64(at::TRIGGER_DELAY) * 1000.0) as u64;
        self.schedule(now + delay, Event::Expose);
    }

    /// A level change on an input line.
    pub fn input_edge(&mut self, edge: Edge) {
        let falling_wanted = (self.registers.u32(at::TRIGGER) >> 8) & 0xf == 1;
        let is_input = self.registers.u32(at::LINE_MODE + 4 * u64::from(edge.line)) == 0;
        if is_input
            && self.trigger_mode()
            && self.trigger_source() == edge.line + 1
            && edge.rising != falling_wanted
        {
            self.trigger(edge.at_ns);
        }
    }

    /// The instant of the next event, if one is to come.
    pub fn next_event(&self) -> Option<u64> {
        let events = self.events.iter().map(|(due, _)| *due);
        events.chain(self.replies.iter().map(|(due, _)| *due)).min()
    }

    /// The instant of the next event or acknowledge after `now`.
    pub fn next_after(&self, now: u64) -> Option<u64> {
        let events = self.events.iter().map(|(due, _)| *due);
        events.chain(self.replies.iter().map(|(due, _)| *due)).filter(|due| *due > now).min()
    }

    /// The instant of the next event of the sensor, acknowledges aside.
    pub fn next_exposure_event(&self) -> Option<u64> {
        self.events.iter().map(|(due, _)| *due).min()
    }

    /// Lets everything happen that is due at `now`; gives the changes of output lines.
    pub fn advance(&mut self, now: u64) -> Vec<Edge> {
        while let Some(at) = self
            .events
            .iter()
            .enumerate()
            .filter(|(_, (due, _))| *due <= now)
            .min_by_key(|(_, (due, _))| *due)
            .map(|(index, _)| index)
        {
            let (due, event) = self.events.remove(at);
            self.happen(due, event);
        }
        std::mem::take(&mut self.edges)
    }

    fn happen(&mut self, due: u64, event: Event) {
        match event {
            Event::FreeRun if self.acquiring && !self.trigger_mode() => {
                let rate = f64::from(self.registers.f32(at::FRAME_RATE)).max(0.1);
                let limited = self.registers.u32(at::FRAME_RATE_ENABLE) != 0;
                let fastest = self.exposure_ns() + 100_000;
                let period = if limited { ((1e9 / rate) as u64).max(fastest) } else { fastest };
                self.expose(due);
                self.schedule(due + period, Event::FreeRun);
            }
            Event::FreeRun => {}
            Event::Expose => self.expose(due),
            Event::ExposureEnd => self.strobe(due, false),
            Event::ReadOut(shot) => self.send(&shot),
        }
    }

    fn expose(&mut self, start: u64) {
        if start < self.exposing_until {
            self.missed_triggers += 1;
            return;
        }
        let r = &self.registers;
        let exposure_ns = self.exposure_ns();
        self.exposing_until = start + exposure_ns;
        let shot = Shot {
            block: self.block,
            mid_ns: start + exposure_ns / 2,
            exposure_ns,
            region: (r.u32(at::OFFSET_X), r.u32(at::OFFSET_Y), r.u32(at::WIDTH), r.u32(at::HEIGHT)),
            pixel_format: r.u32(at::PIXEL_FORMAT),
        };
        self.block += 1;
        self.strobe(start, true);
        self.schedule(self.exposing_until, Event::ExposureEnd);
        self.schedule(self.exposing_until + self.config.readout_ns, Event::ReadOut(shot));
    }

    fn strobe(&mut self, at_ns: u64, active: bool) {
        for line in 0..3_u32 {
            let by = 4 * u64::from(line);
            let output = self.registers.u32(at::LINE_MODE + by) == 1;
            let exposure = self.registers.u32(at::LINE_SOURCE + by) == 1;
            let inverted = self.registers.u32(at::LINE_INVERTER + by) != 0;
            if output && exposure {
                self.edges.push(Edge { line, rising: active != inverted, at_ns });
            }
        }
    }

    fn send(&mut self, shot: &Shot) {
        if !self.acquiring || self.registers.u32(at::SIRM_CONTROL) & 1 == 0 {
            return;
        }
        self.frames += 1;
        let fault = self.faults.strikes(Victim::Frame, self.frames);
        match fault {
            Some(Fault::Skip) => return,
            Some(Fault::Stall) => {
                self.stream.halt();
                return;
            }
            _ => {}
        }
        if self.stream.is_halted() || self.stream.waiting() > self.config.frame_memory * 5 {
            self.dropped += 1;
            return;
        }
        let start = shot.mid_ns - shot.exposure_ns / 2;
        let stamp = self.device_clock(match self.config.stamp_at {
            StampAt::Start => start,
            StampAt::End => start + shot.exposure_ns,
        });
        let size = |address| usize::try_from(self.registers.u32(address)).unwrap_or(0);
        let cut = Cut {
            payload: size(at::SIRM_PAYLOAD_SIZE),
            count: size(at::SIRM_PAYLOAD_COUNT),
            final1: size(at::SIRM_FINAL_1),
            final2: size(at::SIRM_FINAL_2),
        };
        let picture = self.images.picture(shot);
        for transfer in transfers(shot, stamp, picture, cut, fault) {
            self.stream.push(transfer);
        }
        if fault == Some(Fault::Unplug) {
            self.unplug = true;
        }
    }
}

fn power_on(config: &CameraConfig) -> Registers {
    let mut r = Registers::default();
    r.add(0, vec![0; 0x1000]);
    r.add(at::SBRM, vec![0; 0x100]);
    r.add(at::SIRM, vec![0; 0x30]);
    r.add(at::MANIFEST, vec![0; 8 + 64]);
    r.add(at::FEATURES, vec![0; 0x100 + at::FAULTS_LENGTH]);
    let xml = zipped(&description(config.deep_only));

    r.set_u32(0x000, 0x0001_0003);
    r.set_text(0x004, "netcord");
    r.set_text(0x044, "EmulatedU3V");
    r.set_text(0x084, "Emulated");
    r.set_text(0x0C4, "1.0");
    r.set_text(0x104, "no real camera");
    r.set_text(0x144, &config.serial);
    let stacked = if config.stacked { 1 << 13 } else { 0 };
    r.set_u64(0x1C4, 1 | (1 << 8) | stacked);
    r.set_u32(0x1CC, 100);
    r.set_u64(0x1D0, at::MANIFEST);
    r.set_u64(0x1D8, at::SBRM);
    r.set_u64(0x1FC, 1);

    r.set_u32(at::SBRM, 0x0001_0002);
    r.set_u64(at::SBRM + 0x04, 1);
    r.set_u32(at::SBRM + 0x14, 1024);
    r.set_u32(at::SBRM + 0x18, 1024);
    r.set_u32(at::SBRM + 0x1C, 1);
    r.set_u64(at::SBRM + 0x20, at::SIRM);
    r.set_u32(at::SBRM + 0x28, 0x30);
    r.set_u32(at::SBRM + 0x40, if config.speed == LinkSpeed::Super { 8 } else { 4 });

    r.set_u32(at::SIRM_INFO, u32::from(config.alignment()) << 24);
    r.set_u32(at::SIRM_REQUIRED_LEADER, 52);
    r.set_u32(at::SIRM_REQUIRED_TRAILER, 32);

    r.set_u64(at::MANIFEST, 1);
    // Version 1.0.0, zip, schema 1.1.
    r.set_u32(at::MANIFEST + 8, 0x0100_0000);
    r.set_u32(at::MANIFEST + 12, 0x0101_0400);
    r.set_u64(at::MANIFEST + 16, at::XML);
    r.set_u64(at::MANIFEST + 24, xml.len() as u64);
    r.write(at::MANIFEST + 32, &sha1(&xml));
    r.add(at::XML, xml);

    r.set_u32(at::SENSOR_WIDTH, config.sensor.0);
    r.set_u32(at::SENSOR_HEIGHT, config.sensor.1);
    r.set_u32(at::WIDTH, config.sensor.0);
    r.set_u32(at::HEIGHT, config.sensor.1);
    r.set_u32(at::PIXEL_FORMAT, config.pixel_format);
    r.set_u32(at::EXPOSURE, 20_000);
    r.set_u32(at::FRAME_RATE, 20_f32.to_bits());
    r.set_u32(at::FRAME_RATE_ENABLE, 1);
    r.set_u32(at::BALANCE_RATIO, 1_f32.to_bits());
    r.set_u32(at::BALANCE_RATIO + 4, 1_f32.to_bits());
    r.write(at::TEMPERATURE, &415_i32.to_be_bytes());
    r
}
