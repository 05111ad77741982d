//! The same targets under libFuzzer: what reaches new code is kept and damaged further. `tests/fuzz/run` builds and runs it.
#![no_main]
#![allow(clippy::unwrap_used)]

mod mutation;
mod targets;

use std::cell::RefCell;

use libfuzzer_sys::{fuzz_mutator, fuzz_target, fuzzer_mutate};
use mutation::{Dice, mutate};
use targets::{TARGETS, Target};

const ROOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");

thread_local! {
    static TARGET: RefCell<Target> = RefCell::new(chosen());
}

fn chosen() -> Target {
    let wanted = std::env::var("GAPWATCH_FUZZ_TARGET").unwrap();
    let mut targets = TARGETS.iter().filter(|(name, _)| *name == wanted);
    targets.next().unwrap().1()
}

fuzz_target!(|input: &[u8]| {
    TARGET.with_borrow_mut(|target| (target.read)(input));
});

fuzz_mutator!(|data: &mut [u8], size: usize, max_size: usize, seed: u32| {
    let mut dice = Dice(u64::from(seed));
    if dice.below(2) == 0 {
        return fuzzer_mutate(data, size, max_size);
    }
    let mutant = TARGET.with_borrow(|target| {
        let kept = data[..size].to_vec();
        let from = dice.below(target.seeds.len());
        // What libFuzzer keeps, and now and then something whole.
        if size < 8 || dice.below(20) == 0 {
            mutate(&mut dice, &target.seeds)
        } else {
            mutate(&mut dice, &[kept, target.seeds[from].clone()])
        }
    });
    let length = mutant.len().min(max_size);
    data[..length].copy_from_slice(&mutant[..length]);
    length
});
