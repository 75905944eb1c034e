use std::{
    error::Error,
    io::{BufRead as _, BufReader, Write as _},
    process::{Command, Stdio},
    thread,
    time::Duration,
};

use netcord_common::{
    CameraName, Clock as _, DomainName, MonotonicClock,
    bus::{Bus, DomainRemains, FramePublisher, FrameSubscriber, Topic},
};

use super::median;

/// A frame size that is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TransportSize {
    /// Its key in the report.
    pub key: &'static str,
    /// Bytes.
    pub bytes: usize,
}

/// The sizes.
pub const SIZES: [TransportSize; 4] = [
    TransportSize { key: "100k", bytes: 100_000 },
    TransportSize { key: "1m", bytes: 1_000_000 },
    TransportSize { key: "4m", bytes: 4_000_000 },
    TransportSize { key: "16m", bytes: 16_000_000 },
];

/// Frames of each size.
const FRAMES: usize = 300;
/// Frames before they are counted: pages are touched for the first time.
const WARM_UP: usize = 30;
/// Pause between frames; the sizes take turns, so that what disturbs one disturbs all.
const PAUSE: Duration = Duration::from_millis(2);

fn camera(size: &TransportSize) -> CameraName {
    CameraName::new(size.key).expect("a plain key")
}

/// Time from just before a frame is sent until a reader in another process holds it, µs, median, per size.
/// Each frame is written whole before it is sent; what is measured is the transport.
///
/// # Errors
/// What the bus refuses, and a reader that fails.
pub fn measure_transport(progress: &mut dyn FnMut(f64)) -> Result<Vec<(TransportSize, f64)>, Box<dyn Error>> {
    let domain = DomainName::new(format!("bench-{}", std::process::id()))?;
    let result = run(&domain, progress);
    DomainRemains::of(&domain).remove()?;
    result
}

fn run(
    domain: &DomainName,
    progress: &mut dyn FnMut(f64),
) -> Result<Vec<(TransportSize, f64)>, Box<dyn Error>> {
    let bus = Bus::join(domain, "bench")?;
    let publishers = SIZES
        .iter()
        .map(|size| FramePublisher::open(&bus, &Topic::frames(&camera(size)), size.bytes))
        .collect::<Result<Vec<_>, _>>()?;
    let mut reader = Command::new(std::env::current_exe()?)
        .args(["bench", "--transport-reader", domain.as_str()])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()?;
    let mut lines = BufReader::new(reader.stdout.take().ok_or("no pipe to the reader")?).lines();
    lines.next().ok_or("the reader did not start")??;
    let mut latencies = vec![Vec::new(); SIZES.len()];
    let mut rest = vec![0_u8; SIZES.iter().map(|size| size.bytes).max().unwrap_or(0)];
    for n in 0..FRAMES + WARM_UP {
        progress(n as f64 / (FRAMES + WARM_UP) as f64);
        for ((size, publisher), latencies) in SIZES.iter().zip(&publishers).zip(&mut latencies) {
            let mut slot = publisher.loan(size.bytes)?;
            slot.bytes_mut().fill(n as u8);
            // As much memory is written in every turn, so that caches are as cold and the reader has slept as long:
            // these are not of the transport.
            rest[size.bytes..].fill(n as u8);
            std::hint::black_box(&mut rest);
            thread::sleep(PAUSE);
            slot.header_mut().stamps.frame_published_ns = MonotonicClock.now().as_ns();
            publisher.publish(slot)?;
            let line = lines.next().ok_or("the reader ended early")??;
            let latency_ns: f64 = line.parse()?;
            if n >= WARM_UP {
                latencies.push(latency_ns * 1e-3);
            }
        }
    }
    // The reader ends with its standard input.
    drop(reader.stdin.take());
    reader.wait()?;
    SIZES
        .iter()
        .zip(&latencies)
        .map(|(size, latencies)| Ok((*size, median(latencies).ok_or("no frames")?)))
        .collect()
}

/// The reading end, in a process of its own: writes one latency in ns a line for every frame.
///
/// # Errors
/// What the bus refuses.
pub fn serve_reader(domain: &DomainName) -> Result<(), Box<dyn Error>> {
    let bus = Bus::join(domain, "bench-reader")?;
    let subscribers = SIZES
        .iter()
        .map(|size| FrameSubscriber::open(&bus, &Topic::frames(&camera(size)), 2))
        .collect::<Result<Vec<_>, _>>()?;
    thread::spawn(|| {
        // Whoever started this reader closes the pipe, or has died.
        let _ = std::io::copy(&mut std::io::stdin(), &mut std::io::sink());
        std::process::exit(0);
    });
    let mut out = std::io::stdout();
    writeln!(out, "ready")?;
    loop {
        for subscriber in &subscribers {
            // The sizes come in turn, so that each wait is for one that is on its way.
            let frame = loop {
                match subscriber.receive()? {
                    Some(frame) => break frame,
                    None => subscriber.wait(Duration::from_secs(1))?,
                }
            };
            let now = MonotonicClock.now().as_ns();
            writeln!(out, "{}", now.saturating_sub(frame.header().stamps.frame_published_ns))?;
        }
    }
}
