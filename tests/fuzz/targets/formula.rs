//! A formula of a description.
#![no_main]

use libfuzzer_sys::fuzz_target;
use netcord_fuzz::usb::genapi::{Formula, FormulaError, Number};

fuzz_target!(|text: &str| {
    let Ok(formula) = Formula::parse(text) else { return };
    for whole in [false, true] {
        let _ = formula.value::<FormulaError>(whole, &mut |i| Ok(Number::Int(i as i64 * 7 - 3)));
        let _ = formula.value::<FormulaError>(whole, &mut |i| Ok(Number::Float(i as f64 * 1e300 - 0.5)));
    }
});
