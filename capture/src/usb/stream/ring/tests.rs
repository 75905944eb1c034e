use std::{collections::HashMap, time::Duration};

use netcord_emulator::{CameraConfig, FaultPlan, LinkSpeed, UrbEnd, pattern};

use super::*;
use crate::usb::{
    gencp::{Abrm, ControlChannel, Memory, Sbrm, SirmAddress},
    stream::FrameLoss,
    testing::{Bench, BenchPipe},
};

/// The driver's stream on the emulated camera: the same ring, restart and judge as over USB.
struct Stream {
    bench: Bench,
    control: ControlChannel<BenchPipe>,
    sirm: SirmAddress,
    ring: Ring<Vec<u8>>,
    queue: HashMap<u32, (usize, usize)>,
    next_id: u32,
    restarts: usize,
    frames: Vec<(u64, bool)>,
    losses: Vec<FrameLoss>,
}

const START: u64 = 0x20_001C;
const STOP: u64 = 0x20_0020;
const WIDTH: u64 = 0x20_0000;

impl Stream {
    fn new(depth: usize, faults: &str, size: (u32, u32)) -> Self {
        Self::of(CameraConfig::default(), depth, faults, size)
    }

    fn of(config: CameraConfig, depth: usize, faults: &str, (width, height): (u32, u32)) -> Self {
        let packet = u32::try_from(config.speed.packet()).expect("small");
        let mut bench = Bench::of([config]);
        let mut control = bench.channel(0);
        control.write(WIDTH, &width.to_le_bytes()).expect("width");
        control.write(WIDTH + 4, &height.to_le_bytes()).expect("height");
        let abrm = Abrm::read(&mut control).expect("abrm");
        let sbrm = Sbrm::read(&mut control, abrm.sbrm).expect("sbrm");
        let sirm = SirmAddress(sbrm.sirm.expect("a stream"));
        let plan = FramePlan::new(&sirm.read(&mut control).expect("sirm"), packet).expect("a plan");
        let expected = Expected { width, height, pixel_format: 0x0108_0009 };
        let buffers = vec![vec![0; plan.slot]; depth];
        let ring = Ring::new(plan, expected, buffers).expect("large enough");
        bench.lock().0.cameras[0].set_faults(faults.parse::<FaultPlan>().expect("a plan"));
        let mut stream = Self {
            bench,
            control,
            sirm,
            ring,
            queue: HashMap::new(),
            next_id: 0,
            restarts: 0,
            frames: Vec::new(),
            losses: Vec::new(),
        };
        stream.start();
        stream
    }

    fn start(&mut self) {
        self.bench.lock().0.cameras[0].clear_stream_halt();
        self.sirm.write_sizes(&mut self.control, &self.ring.plan().sizes).expect("sizes");
        self.sirm.enable(&mut self.control, true).expect("enabled");
        for unit in 0..self.ring.depth() {
            self.submit(unit);
        }
        self.control.write(START, &1_u32.to_le_bytes()).expect("started");
    }

    fn submit(&mut self, unit: usize) {
        for part in 0..self.ring.parts() {
            let length = self.ring.memory(unit, part).len();
            self.next_id += 1;
            self.queue.insert(self.next_id, (unit, part));
            self.bench.lock().0.cameras[0].stream.submit(self.next_id, length);
        }
    }

    fn restart(&mut self) {
        self.restarts += 1;
        self.control.write(STOP, &1_u32.to_le_bytes()).expect("stopped");
        for id in self.queue.drain().map(|(id, _)| id).collect::<Vec<_>>() {
            self.bench.lock().0.cameras[0].stream.unlink(id);
        }
        self.sirm.enable(&mut self.control, false).expect("disabled");
        self.ring.assembler().restarted(1);
        self.start();
    }

    fn run(&mut self, ms: u64) {
        let mut waited = 0;
        for _ in 0..ms {
            self.bench.pass(Duration::from_millis(1));
            // As the keeper of a real stream does.
            waited = if self.ring.assembler().awaits_trailer() { waited + 1 } else { 0 };
            if waited > 3 {
                self.losses.push(FrameLoss::TrailerLost);
                self.restart();
            }
            let done = self.bench.lock().0.cameras[0].stream.pump();
            for completion in done {
                let Some((unit, part)) = self.queue.remove(&completion.id) else { continue };
                let end = match completion.end {
                    UrbEnd::Done => TransferEnd::Complete,
                    UrbEnd::Stalled => TransferEnd::Stalled,
                    UrbEnd::Overflow => TransferEnd::Overflow,
                };
                let length = completion.data.len();
                self.ring.memory(unit, part)[..length].copy_from_slice(&completion.data);
                let step = self.ring.complete(unit, part, end, length);
                let skip = match step {
                    Step::Continue => continue,
                    Step::Gone => panic!("nobody unplugs it"),
                    Step::OutOfStep(loss) => {
                        self.losses.push(loss);
                        self.restart();
                        break;
                    }
                    Step::Frame(frame, skipped) => {
                        let picture =
                            &self.ring.units[unit].buffer[..frame.stride * frame.leader.height as usize];
                        let right = pattern::first_wrong(frame.leader.block, frame.stride, picture).is_none();
                        self.frames.push((frame.leader.block, right));
                        skipped
                    }
                    Step::Lost(loss, skipped) => {
                        self.losses.push(loss);
                        skipped
                    }
                };
                let reason = self.ring.assembler().skip_reason();
                self.losses.extend(std::iter::repeat_n(reason, skip as usize));
                self.ring.assembler().settled();
                self.submit(unit);
            }
        }
    }
}

#[test]
fn frames_arrive_whole_with_any_number_in_flight() {
    for depth in [1, 2, 3, 7] {
        let mut stream = Stream::new(depth, "", (1920, 1200));
        stream.run(500);
        assert!(stream.frames.len() >= 9, "{} frames", stream.frames.len());
        assert!(stream.frames.iter().enumerate().all(|(i, f)| *f == (i as u64, true)));
        assert_eq!((stream.losses.len(), stream.restarts), (0, 0));
    }
}

#[test]
fn payloads_of_whole_short_packets_end_where_the_trailer_begins_on_a_slow_link() {
    // 320 × 200 px are 125 packets of 512 bytes, and no whole number of 1024; 322 × 201 px are neither.
    for size in [(320, 200), (322, 201), (1920, 1200)] {
        let slow = CameraConfig { speed: LinkSpeed::High, ..CameraConfig::default() };
        let mut stream = Stream::of(slow, 3, "", size);
        stream.run(500);
        assert!(stream.frames.len() >= 9, "{size:?}: {} frames", stream.frames.len());
        assert!(stream.frames.iter().all(|f| f.1));
        assert_eq!((stream.losses.len(), stream.restarts), (0, 0), "{size:?}");
    }
}

#[test]
fn every_stream_fault_loses_only_its_frame_and_is_counted_once() {
    use FrameLoss as L;
    for (fault, loss, restarts) in [
        ("stall", L::Stalled, 1),
        ("lose-leader", L::LeaderLost, 1),
        ("lose-trailer", L::TrailerLost, 1),
        ("short-payload", L::ShortPayload, 1),
        ("long-payload", L::TrailerGarbled, 1),
        ("wrong-block", L::WrongBlock, 0),
        ("wrong-format", L::WrongFormat, 0),
        ("wrong-size", L::WrongSize, 0),
        ("wrong-leader", L::LeaderGarbled, 0),
        ("discarded", L::DeviceDiscarded, 0),
        ("overrun", L::DeviceDiscarded, 0),
        ("skip", L::Skipped, 0),
    ] {
        for depth in [1, 2, 4] {
            let mut stream = Stream::new(depth, &format!("{fault}@5"), (1920, 1200));
            stream.run(600);
            let what = format!("{fault} depth {depth}: {:?} {:?}", stream.losses, stream.frames);
            assert_eq!(stream.losses.first(), Some(&loss), "{what}");
            assert_eq!(stream.restarts, restarts, "{what}");
            assert!(stream.frames.iter().all(|f| f.1), "{what}");
            assert!(stream.frames.len() >= 10, "{what}");
            let blocks: Vec<u64> = stream.frames.iter().map(|f| f.0).collect();
            let gaps: u64 = blocks.windows(2).map(|w| w[1] - w[0] - 1).sum();
            assert_eq!((gaps, stream.losses.len()), (1, 1), "{what}");
        }
    }
}

#[test]
fn a_short_payload_in_one_transfer_needs_no_restart() {
    let mut stream = Stream::new(3, "short-payload@3+4", (640, 480));
    stream.run(800);
    assert_eq!(stream.restarts, 0);
    assert!(stream.losses.iter().all(|l| *l == FrameLoss::ShortPayload));
    assert!(stream.losses.len() >= 3 && stream.frames.len() >= 10, "{:?}", stream.frames);
}

#[test]
fn repeated_faults_of_all_kinds_never_stop_the_stream() {
    let faults = "lose-trailer@4+17 stall@9+23 lose-leader@13+19 short-payload@15+29 skip@20+31";
    let mut stream = Stream::new(4, faults, (1920, 1200));
    stream.run(6000);
    assert!(stream.frames.len() > 80, "{} frames", stream.frames.len());
    assert!(stream.frames.iter().all(|f| f.1));
}
