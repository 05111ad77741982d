//! Damaged copies of what is whole.

/// Numbers that parsers stumble over.
const NUMBERS: [&str; 12] = [
    "0",
    "-1",
    "1e999",
    "-0.0",
    "NaN",
    "4294967296",
    "18446744073709551616",
    "9223372036854775807",
    "1e-320",
    "null",
    "0x7FFFFFFF",
    "99999999999999999999999999999999",
];

/// Numbers that look random, the same for the same seed.
pub struct Dice(pub u64);

impl Dice {
    pub fn next(&mut self) -> u64 {
        // SplitMix64 (Steele, Lea, Flood 2014).
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    pub fn below(&mut self, count: usize) -> usize {
        usize::try_from(self.next() % count.max(1) as u64).unwrap()
    }

    pub fn bytes(&mut self, count: usize) -> Vec<u8> {
        (0..count).map(|_| self.next().to_le_bytes()[0]).collect()
    }

    /// A place in `bytes`, often near its beginning, where headers are.
    fn place(&mut self, bytes: &[u8]) -> usize {
        let within = if self.below(2) == 0 {
            bytes.len()
        } else {
            bytes.len().min(256)
        };
        self.below(within)
    }
}

/// One of `seeds` with one to eight faults.
pub fn mutate(dice: &mut Dice, seeds: &[Vec<u8>]) -> Vec<u8> {
    let mut bytes = seeds[dice.below(seeds.len())].clone();
    for _ in 0..=dice.below(8) {
        if bytes.is_empty() {
            bytes = dice.bytes(8);
        }
        let at = dice.place(&bytes);
        let length = 1 + dice.below(32.min(bytes.len() - at));
        match dice.below(9) {
            0 => bytes[at] ^= 1 << dice.below(8),
            1 => bytes[at] = [0, 1, 0x7F, 0x80, 0xFF][dice.below(5)],
            2 => {
                let new = dice.bytes(length);
                bytes.splice(at..at, new);
            }
            3 => drop(bytes.drain(at..at + length)),
            4 => {
                let again = bytes[at..at + length].to_vec();
                let to = dice.place(&bytes);
                bytes.splice(to..to, again);
            }
            5 => bytes.truncate(at),
            6 => {
                let other = &seeds[dice.below(seeds.len())];
                let from = dice.below(other.len());
                bytes.truncate(at);
                bytes.extend(&other[from..]);
            }
            _ => number(dice, &mut bytes, at),
        }
    }
    bytes
}

/// Puts another number in the place of the next one after `at`.
fn number(dice: &mut Dice, bytes: &mut Vec<u8>, at: usize) {
    let digit = |byte: &u8| byte.is_ascii_digit();
    let Some(start) = bytes[at..].iter().position(digit).map(|n| at + n) else {
        return;
    };
    let end = bytes[start..]
        .iter()
        .position(|b| !digit(b))
        .map_or(bytes.len(), |n| start + n);
    bytes.splice(start..end, NUMBERS[dice.below(NUMBERS.len())].bytes());
}
