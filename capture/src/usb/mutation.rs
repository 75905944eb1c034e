//! Every parser of bytes that come from a device, against valid packets of the emulated camera with
//! bytes changed, cut, doubled and swapped: none may panic or loop, whatever the bytes are. The numbers
//! are deterministic, so that a failure can be repeated.

use rand::{Rng as _, RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;

use super::{
    genapi::{Formula, GenApi},
    gencp::{
        Abrm, Command, Exchange, Manifest, Memory, MemoryError, Patience, Retry, parse_ack, parse_event,
        read_description, unzip_single,
    },
    stream::{parse_leader, parse_trailer},
    testing::Bench,
};

fn mutated(rng: &mut Pcg64Mcg, seed: &[u8]) -> Vec<u8> {
    let mut bytes = seed.to_vec();
    for _ in 0..rng.random_range(1..6) {
        if bytes.is_empty() {
            break;
        }
        let at = rng.random_range(0..bytes.len());
        match rng.random_range(0..6) {
            0 => bytes[at] ^= 1 << rng.random_range(0..8),
            1 => bytes[at] = [0, 0xff, 0x7f, 0x80][rng.random_range(0..4)],
            2 => bytes.truncate(at),
            3 => bytes.insert(at, (rng.next_u32() & 0xff) as u8),
            4 => {
                let end = (at + rng.random_range(1..16)).min(bytes.len());
                bytes.drain(at..end);
            }
            _ => {
                let other = rng.random_range(0..bytes.len());
                bytes.swap(at, other);
            }
        }
    }
    bytes
}

fn each(count: usize, seeds: &[Vec<u8>], mut parse: impl FnMut(&[u8])) {
    let mut rng = Pcg64Mcg::seed_from_u64(20);
    for i in 0..count {
        parse(&mutated(&mut rng, &seeds[i % seeds.len()]));
    }
}

#[test]
fn packets_of_all_kinds_survive_mutation() {
    let ack = |code: u8, data: &[u8]| {
        [&[0x55, 0x33, 0x56, 0x43, 0, 0, code, 8, data.len() as u8, 0, 1, 0], data].concat()
    };
    let mut leader = [b"U3VL", &[0; 48][..]].concat();
    leader[18] = 1;
    let trailer = [b"U3VT", &[0; 28][..]].concat();
    let event = [&b"U3VE"[..], &[0, 0, 0, 0x0c, 26, 0, 1, 0], &[14, 0, 1, 0], &[7; 10], &[0; 12]].concat();
    let seeds =
        [ack(1, &[1, 2, 3, 4]), ack(3, &[0, 0, 4, 0]), ack(5, &[0, 0, 200, 0]), leader, trailer, event];
    let now = netcord_common::Stamp::from_ns(1);
    each(200_000, &seeds, |bytes| {
        let _ = parse_ack(bytes);
        let _ = parse_event(bytes);
        let _ = parse_leader(bytes);
        let _ = parse_trailer(bytes);
        let _ = Manifest::parse(bytes).device();
        let command = Command::Read { address: 0, length: 4 };
        let mut exchange = Exchange::new(&command, 0, Patience::default(), Retry::Allowed);
        exchange.sent(now);
        let _ = exchange.received(bytes, now);
    });
}

#[test]
fn formulas_survive_mutation() {
    let seeds = ["(A>=0x10) ? ROUND(B*2**3,2) : ~C & 0xFF | -D", "((P1=0)||(P1<>1))&&SIN(PI())<1.5E-3"]
        .map(|t| t.as_bytes().to_vec());
    each(50_000, &seeds, |bytes| {
        if let Ok(formula) = Formula::parse(&String::from_utf8_lossy(bytes)) {
            let _ = formula.value::<super::genapi::FormulaError>(false, &mut |i| {
                Ok(super::genapi::Number::Int(i as i64 * 7 - 3))
            });
        }
    });
}

struct Ones;

impl Memory for Ones {
    fn read(&mut self, _: u64, out: &mut [u8]) -> Result<(), MemoryError> {
        out.fill(1);
        Ok(())
    }

    fn write(&mut self, _: u64, _: &[u8]) -> Result<(), MemoryError> {
        Ok(())
    }
}

#[test]
fn descriptions_and_their_zip_files_survive_mutation() {
    let mut bench = Bench::new();
    let mut channel = bench.channel(0);
    let abrm = Abrm::read(&mut channel).expect("abrm");
    let text = read_description(&mut channel, abrm.manifest).expect("a description");
    each(2_000, &[text.into_bytes()], |bytes| {
        let Ok(mut api) = GenApi::load(&String::from_utf8_lossy(bytes)) else { return };
        for name in ["Width", "ExposureTime", "TriggerMode", "LineMode", "BalanceRatio", "DeviceUserID"] {
            let _ = api.get(&mut Ones, name);
            let _ = api.info(&mut Ones, name);
            let _ = api.set(&mut Ones, name, "1");
        }
    });
    let zip = include_bytes!("gencp/testdata/python-deflate.zip").to_vec();
    each(50_000, &[zip], |bytes| drop(unzip_single(bytes)));
}

/// Registers that repeat some bytes without end, as the fuzzer's do; reads are counted.
struct Repeated<'a>(&'a [u8], usize);

impl Memory for Repeated<'_> {
    fn read(&mut self, address: u64, out: &mut [u8]) -> Result<(), MemoryError> {
        self.1 += out.len();
        let from = (address % self.0.len().max(1) as u64) as usize;
        out.iter_mut().zip(self.0.iter().cycle().skip(from)).for_each(|(to, byte)| *to = *byte);
        Ok(())
    }

    fn write(&mut self, _: u64, _: &[u8]) -> Result<(), MemoryError> {
        Ok(())
    }
}

#[test]
fn inputs_that_the_fuzzer_found_stay_harmless() {
    let found = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/fuzz/found");
    let mut inputs = 0;
    for target in std::fs::read_dir(found).expect("the folder is kept") {
        let target = target.expect("an entry").path();
        for input in std::fs::read_dir(&target).expect("a folder for each target") {
            let bytes = std::fs::read(input.expect("an entry").path()).expect("a file");
            inputs += 1;
            let _ = (parse_ack(&bytes), parse_event(&bytes), parse_leader(&bytes), parse_trailer(&bytes));
            let _ = (unzip_single(&bytes), Formula::parse(&String::from_utf8_lossy(&bytes)));
            let mut memory = Repeated(&bytes, 0);
            let _ = read_description(&mut memory, 0);
            assert!(memory.1 < 9 << 20, "{} bytes were read for {target:?}", memory.1);
            let _ = GenApi::load(&String::from_utf8_lossy(&bytes));
        }
    }
    assert!(inputs > 0);
}
