use std::collections::VecDeque;

/// A reading of the device's clock between two instants of the host's.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ClockReading {
    /// The device's clock, ns.
    pub device_ns: u64,
    /// CLOCK_MONOTONIC before the reading was asked for.
    pub before_ns: u64,
    /// CLOCK_MONOTONIC after its answer.
    pub after_ns: u64,
}

/// A continuous estimate of a device's clock against CLOCK_MONOTONIC: offset and drift by weighted
/// least squares over the last readings, each as uncertain as its round trip was long.
#[derive(Debug, Clone, Default)]
pub struct DeviceClock {
    readings: VecDeque<ClockReading>,
    fit: Option<Fit>,
}

/// host = reference + offset + (1 + drift) · (device − device reference), with the variances.
#[derive(Debug, Clone, Copy)]
struct Fit {
    device_ref: u64,
    host_ref: u64,
    offset: f64,
    drift: f64,
    /// Mean of the device instants against the reference, ns.
    mean: f64,
    offset_var: f64,
    drift_var: f64,
}

/// A device instant on the host's clock.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HostInstant {
    /// CLOCK_MONOTONIC, ns.
    pub ns: u64,
    /// Standard deviation, ns.
    pub sigma_ns: f64,
}

/// Readings that count: at one or two a second, half a minute; crystals are stable over that.
const READINGS: usize = 48;
/// No crystal is worse than this; before there is a baseline, drift is 0 within it.
const DRIFT_PRIOR: f64 = 100e-6;

impl DeviceClock {
    /// Takes a reading into account. A clock that has jumped (the device was reset) begins anew.
    pub fn add(&mut self, reading: ClockReading) {
        if let Some(last) = self.readings.back() {
            let device = reading.device_ns.wrapping_sub(last.device_ns).cast_signed() as f64;
            let host = reading.before_ns.saturating_sub(last.after_ns) as f64;
            let span = (reading.after_ns.saturating_sub(last.before_ns)) as f64;
            let slack = 1e-3 * span + 1e6;
            if device < host - slack || device > span + slack {
                self.readings.clear();
            }
        }
        self.readings.push_back(reading);
        if self.readings.len() > READINGS {
            self.readings.pop_front();
        }
        self.fit = self.solve();
    }

    /// Readings that count now.
    pub fn len(&self) -> usize {
        self.readings.len()
    }

    /// Whether there is none yet.
    pub fn is_empty(&self) -> bool {
        self.readings.is_empty()
    }

    /// How much faster the device's clock runs than the host's, in parts of one.
    pub fn drift(&self) -> Option<f64> {
        self.fit.map(|f| -f.drift)
    }

    fn solve(&self) -> Option<Fit> {
        let first = self.readings.front()?;
        let (device_ref, host_ref) = (first.device_ns, first.before_ns);
        // x: device, y: host − device, both against the reference, so that f64 keeps nanoseconds.
        let points: Vec<(f64, f64, f64)> = self
            .readings
            .iter()
            .map(|r| {
                let trip = r.after_ns.saturating_sub(r.before_ns) as f64;
                let x = r.device_ns.wrapping_sub(device_ref).cast_signed() as f64;
                let y = (r.before_ns.wrapping_sub(host_ref)) as f64 + trip / 2.0 - x;
                // The reading lies anywhere in the round trip: variance of a uniform distribution.
                let variance = (trip * trip / 12.0).max(1e4);
                (x, y, 1.0 / variance)
            })
            .collect();
        let weight: f64 = points.iter().map(|p| p.2).sum();
        let mean_x = points.iter().map(|p| p.0 * p.2).sum::<f64>() / weight;
        let mean_y = points.iter().map(|p| p.1 * p.2).sum::<f64>() / weight;
        // The prior on the drift is one more equation: drift = 0 ± DRIFT_PRIOR.
        let prior = 1.0 / (DRIFT_PRIOR * DRIFT_PRIOR);
        let xx = points.iter().map(|p| p.2 * (p.0 - mean_x).powi(2)).sum::<f64>() + prior;
        let xy = points.iter().map(|p| p.2 * (p.0 - mean_x) * (p.1 - mean_y)).sum::<f64>();
        Some(Fit {
            device_ref,
            host_ref,
            offset: mean_y,
            drift: xy / xx,
            mean: mean_x,
            offset_var: 1.0 / weight,
            drift_var: 1.0 / xx,
        })
    }

    /// The host's instant of a device instant; `None` before the first reading.
    pub fn host(&self, device_ns: u64) -> Option<HostInstant> {
        let f = self.fit?;
        let x = device_ns.wrapping_sub(f.device_ref).cast_signed();
        let from_mean = x as f64 - f.mean;
        let correction = f.offset + f.drift * from_mean;
        let host = f.host_ref.cast_signed().wrapping_add(x).wrapping_add(correction.round() as i64);
        let variance = f.offset_var + f.drift_var * from_mean * from_mean;
        Some(HostInstant { ns: u64::try_from(host).unwrap_or(0), sigma_ns: variance.sqrt() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A device that is `ppm` fast; the answer lies anywhere in a round trip of 60 to 400 µs.
    fn readings(ppm: f64, count: u64) -> (DeviceClock, impl Fn(u64) -> u64) {
        let device =
            move |host: u64| (77_000_000_000 + host).wrapping_add_signed((host as f64 * ppm * 1e-6) as i64);
        let mut clock = DeviceClock::default();
        let mut noise = 12345_u64;
        for i in 0..count {
            noise = noise.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            let trip = 60_000 + (noise >> 40) % 340_000;
            let at = 3_000_000_000_000 + i * 500_000_000;
            let share = (noise >> 20) % (trip + 1);
            clock.add(ClockReading { device_ns: device(at + share), before_ns: at, after_ns: at + trip });
        }
        (clock, device)
    }

    #[test]
    fn instants_are_right_within_the_uncertainty_that_is_claimed() {
        for ppm in [-80.0, 0.0, 35.0] {
            for count in [1, 3, 10, 48, 200] {
                let (clock, device) = readings(ppm, count);
                let truth = 3_000_000_000_000 + (count - 1) * 500_000_000 + 100_000_000;
                let host = clock.host(device(truth)).expect("readings");
                let error = host.ns as f64 - truth as f64;
                assert!(
                    error.abs() < 4.0 * host.sigma_ns + 200.0,
                    "{ppm} {count}: {error} ± {}",
                    host.sigma_ns
                );
                if count >= 48 {
                    assert!(host.sigma_ns < 40_000.0, "{}", host.sigma_ns);
                    let drift = clock.drift().expect("a fit") * 1e6;
                    assert!((drift - ppm).abs() < 10.0, "{drift} instead of {ppm} ppm");
                }
            }
        }
    }

    #[test]
    fn a_clock_that_was_reset_begins_anew() {
        let (mut clock, _) = readings(10.0, 20);
        let at = 3_020_000_000_000;
        clock.add(ClockReading { device_ns: 5_000, before_ns: at, after_ns: at + 100_000 });
        assert_eq!(clock.len(), 1);
        let host = clock.host(1_005_000).expect("a reading");
        assert!((host.ns as f64 - (at + 1_050_000) as f64).abs() < 60_000.0, "{host:?}");
    }
}
