use netcord_common::PixelFormat;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::{BackgroundRow, ColourGate, Kernel, LevelTables, WORD_PX};

fn tables(rng: &mut Pcg64Mcg) -> LevelTables {
    let mut random = |most: u8| std::array::from_fn(|_| rng.random_range(0..=most));
    LevelTables { brighter: random(40), dimmer: random(40), threshold: random(30) }
}

fn bytes(rng: &mut Pcg64Mcg, length: usize) -> Vec<u8> {
    (0..length).map(|_| rng.random()).collect()
}

/// Rows of awkward lengths, contents over the whole range: the vector kernels must give the plain one's bits.
#[test]
fn every_kernel_gives_the_bits_of_the_plain_one() {
    let kernel = Kernel::detect();
    if kernel == Kernel::Plain {
        println!("SKIPPED: this machine has no vector kernel");
    }
    let mut rng = Pcg64Mcg::seed_from_u64(1);
    for round in 0..200 {
        let width = [1920, 64, 33, 2, 1, 31, 255, 1000, 1936][round % 9];
        let background = bytes(&mut rng, width);
        let background2 = bytes(&mut rng, width);
        // Near the background, so that both verdicts occur.
        let mut near = |of: &[u8]| {
            of.iter()
                .map(|b| b.saturating_add(rng.random_range(0..60)).saturating_sub(30))
                .collect::<Vec<u8>>()
        };
        let rows = [near(&background), near(&background2)];
        let zones = (0..rng.random_range(1..9)).map(|_| tables(&mut rng)).collect::<Vec<_>>();
        let words = width.div_ceil(WORD_PX);
        let (mut found, mut expected) = (vec![0; words], vec![0; words]);
        let rows = [&rows[0][..], &rows[1][..]];
        let both = [&background[..], &background2[..]];
        kernel.foreground(rows, both, &zones, 256, 4096, &mut found);
        Kernel::Plain.foreground(rows, both, &zones, 256, 4096, &mut expected);
        assert_eq!(found, expected);
        // Where words are zero nothing is looked at; elsewhere all cells are, whatever bits are set.
        let mut among = (0..words).map(|_| if rng.random_bool(0.5) { 4 } else { 0 }).collect::<Vec<u16>>();
        let looked =
            expected.iter().zip(&among).map(|(e, a)| if *a == 0 { 0 } else { *e }).collect::<Vec<_>>();
        kernel.foreground_among(rows, both, &zones, 256, &mut among);
        assert_eq!(among, looked);

        let weight = |rng: &mut Pcg64Mcg| rng.random_range(-1.0..1.0_f32);
        let tests = (0..6)
            .map(|_| {
                ([weight(&mut rng), weight(&mut rng), weight(&mut rng)], 100.0 * weight(&mut rng) - 60.0)
            })
            .collect::<Vec<_>>();
        let gate = ColourGate::new(PixelFormat::ALL[round % 5], &tests);
        let mut by_plain = expected.clone();
        kernel.colour(rows, &gate, &mut found);
        Kernel::Plain.colour(rows, &gate, &mut by_plain);
        assert_eq!(found, by_plain);
        // Whatever bits are set beyond the row's end: none is left there.
        let (mut all, mut all_by_plain) = (vec![0xffff; words], vec![0xffff; words]);
        kernel.colour(rows, &gate, &mut all);
        Kernel::Plain.colour(rows, &gate, &mut all_by_plain);
        assert_eq!(all, all_by_plain);
        let cells = |cell: &usize| all[cell / 16] >> (cell % 16) & 1 == 1;
        assert!((0..16 * words).filter(cells).all(|cell| 2 * cell < width), "width {width}");

        let states = [bytes(&mut rng, width), bytes(&mut rng, width)];
        let patience = rng.random_range(1..=100);
        let learn = |kernel: Kernel| {
            let (mut level, mut other, mut evidence) =
                (background.clone(), states[0].clone(), states[1].clone());
            let row = BackgroundRow { level: &mut level, other: &mut other, evidence: &mut evidence };
            kernel.learn(rows[0], row, &zones[0], patience);
            (level, other, evidence)
        };
        assert_eq!(learn(kernel), learn(Kernel::Plain));
        assert_eq!(
            kernel.probe(rows[0], &background, &zones[0]),
            Kernel::Plain.probe(rows[0], &background, &zones[0])
        );
        assert_eq!(kernel.sum(rows[0]), rows[0].iter().map(|b| u64::from(*b)).sum::<u64>());
    }
}

#[test]
fn a_gate_knows_where_each_mosaic_has_its_red() {
    // Red above the mean of the greens.
    let test = ([1.0, -0.5, 0.0], 0.0);
    for format in PixelFormat::ALL {
        let gate = ColourGate::new(format, &[test]);
        let Some((x, y)) = format.red_at() else {
            assert!(gate.passes([9; 4]), "grey frames have no hue to be tested");
            continue;
        };
        let mut cell = [50; 4];
        cell[2 * y + x] = 110;
        assert!(gate.passes(cell), "{format}");
        let mut cell = [50; 4];
        cell[2 * (1 - y) + (1 - x)] = 110;
        assert!(!gate.passes(cell), "{format}: blue");
    }
}

/// What learning is for, in one pixel's life.
#[test]
fn a_passing_ball_leaves_no_trace_a_new_level_is_believed_and_the_old_one_remembered() {
    let tables = LevelTables { threshold: [5; 16], ..LevelTables::default() };
    let (mut level, mut other, mut evidence) = ([80_u8], [0_u8], [0_u8]);
    let mut look = |seen: u8| {
        let row = BackgroundRow { level: &mut level, other: &mut other, evidence: &mut evidence };
        Kernel::Plain.learn(&[seen], row, &tables, 10);
        level[0]
    };
    for expected in 81..=84 {
        assert_eq!(look(84), expected, "follows slow changes");
    }
    for seen in [200, 84, 200, 84, 84, 84] {
        assert_eq!(look(seen), 84, "a ball passes");
    }
    for i in 0..9 {
        assert_eq!(look(150), 84, "look {i}");
    }
    assert_eq!(look(150), 150, "somebody stands there now");
    for _ in 0..30 {
        look(150);
    }
    assert_eq!(look(84), 84, "gone again: the former background is there at once");
}
