use std::path::Path;

use super::*;
use crate::usb::{
    gencp::{Abrm, MemoryError, read_description},
    testing::Bench,
};

/// Memory of which every byte exists and keeps what is written.
#[derive(Default)]
struct Everywhere {
    written: HashMap<u64, u8>,
    rest: u8,
}

impl Memory for Everywhere {
    fn read(&mut self, address: u64, out: &mut [u8]) -> std::result::Result<(), MemoryError> {
        for (i, byte) in out.iter_mut().enumerate() {
            *byte = self.written.get(&address.wrapping_add(i as u64)).copied().unwrap_or(self.rest);
        }
        Ok(())
    }

    fn write(&mut self, address: u64, data: &[u8]) -> std::result::Result<(), MemoryError> {
        for (i, byte) in data.iter().enumerate() {
            self.written.insert(address.wrapping_add(i as u64), *byte);
        }
        Ok(())
    }
}

fn emulated() -> (GenApi, Bench) {
    let mut bench = Bench::new();
    let mut memory = bench.channel(0);
    let abrm = Abrm::read(&mut memory).expect("the bootstrap registers");
    let text = read_description(&mut memory, abrm.manifest).expect("the description");
    (GenApi::load(&text).expect("a description"), bench)
}

#[test]
fn features_of_the_emulated_camera_are_read_and_written_through_gencp() {
    let (mut api, mut bench) = emulated();
    let m = &mut bench.channel(0);
    assert_eq!(api.get(m, "DeviceModelName"), Ok(Value::Text("EmulatedU3V".into())));
    assert_eq!(api.get(m, "Width"), Ok(Value::Integer(1920)));
    assert_eq!(api.get(m, "PixelFormat"), Ok(Value::Entry("BayerRG8".into())));
    assert_eq!(api.get(m, "DeviceTemperature"), Ok(Value::Float(41.5)), "big-endian, in tenths");
    // Through a converter whose scale is another node, and one of its own.
    for (name, value, raw) in [("ExposureTime", "1234.5", 12345_i64), ("Gain", "6.02", 602)] {
        api.set(m, name, value).expect(name);
        assert_eq!(api.get_float(m, name).expect(name), value.parse::<f64>().expect("a number"));
        let register = if name == "Gain" { "GainReg" } else { "ExposureReg" };
        assert_eq!(api.get_int(m, register), Ok(raw));
    }
    // Three features in one register.
    api.set(m, "TriggerMode", "On").expect("on");
    api.set(m, "TriggerSource", "Line1").expect("line");
    api.set(m, "TriggerActivation", "FallingEdge").expect("edge");
    assert_eq!(api.get(m, "TriggerMode"), Ok(Value::Entry("On".into())));
    assert_eq!(api.get(m, "TriggerSource"), Ok(Value::Entry("Line1".into())));
    // Selected by an index, and by a formula in the address.
    api.set(m, "LineSelector", "Line2").expect("line");
    api.set(m, "LineMode", "Output").expect("mode");
    api.set(m, "LineSelector", "Line0").expect("line");
    assert_eq!(api.get(m, "LineMode"), Ok(Value::Entry("Input".into())));
    api.set(m, "BalanceRatioSelector", "Blue").expect("blue");
    api.set(m, "BalanceRatio", "1.5").expect("ratio");
    api.set(m, "BalanceRatioSelector", "Red").expect("red");
    assert_eq!(api.get(m, "BalanceRatio"), Ok(Value::Float(1.0)));
    api.set(m, "DeviceUserID", "left").expect("name");
    assert_eq!(api.get(m, "DeviceUserID"), Ok(Value::Text("left".into())));
    api.execute(m, "TimestampLatch").expect("latched");
    assert!(api.get_int(m, "TimestampLatchValue").expect("a clock") >= 5_000_000_000);
}

#[test]
fn what_is_not_allowed_is_refused_with_what_would_be() {
    let (mut api, mut bench) = emulated();
    let m = &mut bench.channel(0);
    let error = |e: FeatureError| e.to_string();
    assert_eq!(
        api.set(m, "Width", "1000").map_err(error),
        Err("1000 is out of range for Width: 16 to 1920, in steps of 16".into())
    );
    let entry = api.set(m, "TriggerSource", "Line9").map_err(error).expect_err("no such line");
    assert!(entry.contains("valid are Software, Line0"), "{entry}");
    assert!(api.get(m, "ExposureTim").map_err(error).expect_err("a typing error").contains("ExposureTime"));
    assert!(matches!(api.set(m, "PayloadSize", "1"), Err(FeatureError::ReadOnly(_))));
    assert!(matches!(api.get(m, "TriggerSoftware"), Err(FeatureError::WriteOnly(_))));
    api.set(m, "TLParamsLocked", "1").expect("locked");
    assert!(matches!(api.set(m, "Width", "960"), Err(FeatureError::Locked(_))));
    let info = api.info(m, "ExposureTime").expect("its range");
    assert_eq!((info.unit.as_deref(), info.access), (Some("us"), Access::ReadWrite));
    let range = info.range.expect("a range");
    assert_eq!((range.min.float(), range.max.float()), (10.0, 1e6));
    api.set(m, "AcquisitionFrameRateEnable", "false").expect("off");
    assert!(matches!(api.get(m, "AcquisitionFrameRate"), Err(FeatureError::NotAvailable(_))));
}

#[test]
fn circles_and_broken_nodes_are_errors() {
    let xml = |nodes: &str| format!("<RegisterDescription>{nodes}</RegisterDescription>");
    let mut memory = Everywhere::default();
    for nodes in [
        "<Integer Name='A'><pValue>B</pValue></Integer><Integer Name='B'><pValue>A</pValue></Integer>",
        "<IntSwissKnife Name='A'><pVariable Name='X'>A</pVariable><Formula>X+X</Formula></IntSwissKnife>",
        "<Integer Name='A'><pIsAvailable>A</pIsAvailable><Value>0</Value></Integer>",
        "<Integer Name='A'><pValue>Gone</pValue></Integer>",
        "<IntSwissKnife Name='A'><Formula></Formula></IntSwissKnife>",
        "<IntReg Name='A'><Address>0</Address><Length>0</Length></IntReg>",
        "<IntReg Name='A'><Address>0</Address><Length>99999999999</Length></IntReg>",
    ] {
        let mut api = GenApi::load(&xml(nodes)).expect(nodes);
        assert!(api.get(&mut memory, "A").is_err(), "{nodes}");
        let _ = api.set(&mut memory, "A", "1");
        let _ = api.info(&mut memory, "A");
    }
    assert!(GenApi::load("<x/>").is_err());
    assert!(GenApi::load("junk").is_err());
    assert!(GenApi::load("junk\n<RegisterDescription/>").is_ok(), "a tool's line before it is cut off");
}

#[test]
fn bits_of_big_endian_registers_are_counted_from_the_other_end() {
    let bits = |lsb, msb, signed| Bits { mask: Some((lsb, msb)), signed };
    let bytes = [0x12, 0x34, 0x56, 0xF8];
    assert_eq!(decode(&bytes, true, bits(31, 24, false)), 0xF8);
    assert_eq!(decode(&bytes, true, bits(7, 0, false)), 0x12);
    assert_eq!(decode(&bytes, false, bits(0, 7, false)), 0x12);
    assert_eq!(decode(&bytes, true, bits(31, 28, true)), -8);
    assert_eq!(decode(&[0xff; 8], false, Bits { mask: None, signed: false }), -1);
    assert_eq!(decode(&[0xfe, 0xff], false, Bits { mask: None, signed: true }), -2);
}

/// Descriptions of real cameras, from `../shared/data`; they are not part of the project.
#[test]
fn real_cameras_standard_features_can_be_read_and_written() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data/genicam-xml");
    let Ok(files) = std::fs::read_dir(&folder) else {
        eprintln!("SKIPPED: {} is not there", folder.display());
        return;
    };
    let mut read = 0;
    let mut exact = (0, 0);
    let mut failures = Vec::new();
    for path in
        files.filter_map(|f| f.ok().map(|f| f.path())).filter(|p| p.extension().is_some_and(|e| e == "xml"))
    {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let text = std::fs::read(&path).expect("a file");
        let mut api = GenApi::load(&String::from_utf8_lossy(&text)).expect(&name);
        // Nothing may panic, whatever the registers hold.
        for fill in [0_u8, 0xff] {
            let mut memory = Filled(fill);
            for node in api.nodes.iter().map(|n| n.name.clone()).collect::<Vec<_>>() {
                let _ = api.get(&mut memory, &node);
                let _ = api.info(&mut memory, &node);
            }
        }
        for feature in STANDARD {
            if !api.has(feature) {
                continue;
            }
            // Steps and scales are read from registers: where zeros leave nothing to divide by, ones do.
            let mut attempt = |rest| {
                let mut memory = Everywhere { rest, ..Everywhere::default() };
                try_feature(&mut api, &mut memory, feature, &mut exact)
            };
            match attempt(0).or_else(|_| attempt(1)) {
                Ok(()) => read += 1,
                Err(e) => failures.push(format!("{name} {feature}: {e}")),
            }
        }
    }
    eprintln!("{read} features, {} of {} entries", exact.0, exact.1);
    assert!(failures.is_empty(), "{}", failures.join("\n"));
    assert!(exact.0 * 100 >= exact.1 * 85, "{} of {} entries were read back as written", exact.0, exact.1);
    assert!(read > 100, "only {read} features");
}

const STANDARD: [&str; 22] = [
    "Width",
    "Height",
    "OffsetX",
    "OffsetY",
    "PixelFormat",
    "ExposureTime",
    "Gain",
    "AcquisitionMode",
    "TriggerSelector",
    "TriggerMode",
    "TriggerSource",
    "TriggerSoftware",
    "TriggerActivation",
    "TriggerDelay",
    "LineSelector",
    "LineMode",
    "LineSource",
    "AcquisitionStart",
    "AcquisitionStop",
    "PayloadSize",
    "TLParamsLocked",
    "TimestampLatch",
];

struct Filled(u8);

impl Memory for Filled {
    fn read(&mut self, _: u64, out: &mut [u8]) -> std::result::Result<(), MemoryError> {
        out.fill(self.0);
        Ok(())
    }

    fn write(&mut self, _: u64, _: &[u8]) -> std::result::Result<(), MemoryError> {
        Ok(())
    }
}

/// Reads and writes a feature on a memory of zeros, past what a real camera's state registers forbid.
fn try_feature(
    api: &mut GenApi,
    memory: &mut Everywhere,
    name: &str,
    exact: &mut (usize, usize),
) -> Result<()> {
    let id = api.find(name)?;
    // A memory of zeros says that nothing is implemented.
    for node in &mut api.nodes {
        node.conditions = Conditions::default();
        if let Kind::Enumeration(_, entries) = &mut node.kind {
            entries.iter_mut().for_each(|e| e.conditions = Conditions::default());
        }
    }
    let mut visit = Visit { memory, depth: 0, visits: 0 };
    let access = api.access(id, &mut visit)?;
    if !access.writable() {
        return api.number(id, &mut visit).map(drop);
    }
    match api.nodes[id].kind.clone() {
        Kind::Command { .. } => api.execute(memory, name),
        Kind::Enumeration(_, entries) => {
            for entry in &entries {
                api.set(memory, name, &entry.name)?;
                if access.readable() {
                    let got = api.get_int(memory, name)?;
                    // Some cameras derive what they say from other registers, and those are zero here: then
                    // it is at least one of the entries.
                    assert!(entries.iter().any(|e| e.value == got), "{name} = {}: {got}", entry.name);
                    exact.0 += usize::from(got == entry.value);
                    exact.1 += 1;
                }
            }
            Ok(())
        }
        _ => {
            let range = api.range(id, &mut visit)?;
            let (min, max) = range.map_or((0.0, 100.0), |r| (r.min.float(), r.max.float()));
            if min > max {
                // The limits come from registers, which are all zero here.
                return Ok(());
            }
            let step = range.and_then(|r| r.increment).filter(|i| *i > 0).unwrap_or(1) as f64;
            let wanted = (min + 4.0 * step).min(max);
            let number = if matches!(api.nodes[id].kind, Kind::Float(..)) {
                format!("{wanted:?}")
            } else {
                format!("{}", (min + ((wanted - min) / step).floor() * step) as i64)
            };
            match api.set(memory, name, &number) {
                Ok(()) if access.readable() => api.get(memory, name).map(drop),
                // A scale that is read from a register is zero here.
                Err(FeatureError::Formula(_)) => Ok(()),
                other => other,
            }
        }
    }
}
