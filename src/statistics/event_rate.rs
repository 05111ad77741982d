//! How often something happens: bounds of a rate from a count, and what they say about a rate that was asked for.

use std::fmt;

/// Probability that a rate is beyond a one-sided bound.
const BEYOND: f64 = 0.05;
/// The same for each end of a two-sided 95 % interval.
const BEYOND_EACH_END: f64 = 0.025;

/// What a count says about the rate that was asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Loudness {
    /// The upper bound of the rate is at most the rate that was asked for.
    NotLouder,
    /// The lower bound of the rate is above the rate that was asked for.
    Louder,
    /// Neither is the case.
    NotShown {
        /// Number of further hours without an entry after which the same upper bound on the number of entries would
        /// show that the rate is not louder than asked.
        missing_hours: f64,
    },
}

impl Loudness {
    /// The words, which are the same everywhere.
    pub fn name(self) -> &'static str {
        match self {
            Self::NotLouder => "not louder than asked",
            Self::Louder => "louder than asked",
            Self::NotShown { .. } => "not shown",
        }
    }
}

/// Entries into `Gap` that were counted in judged hours, with the one-sided 95 % bounds of their rate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CountedRate {
    hours: f64,
    /// One-sided bounds of the number of entries in those hours.
    fewest: f64,
    most: f64,
    /// Whether `most` is the bound for independent entries (Poisson, exact).
    independent: bool,
}

impl CountedRate {
    /// The rate of `entries` in judged `hours`. Its bounds are those of independent entries (Poisson, exact), or those
    /// from resampling drives (`resampled`, entries an hour) if these are wider, because entries of a drive depend on
    /// each other.
    pub fn new(entries: u64, hours: f64, resampled: Option<(f64, f64)>) -> Self {
        let (fewest, most) = poisson_bounds(entries, BEYOND);
        let (low, high) =
            resampled.map_or((fewest, most), |(low, high)| (low * hours, high * hours));
        Self {
            hours,
            fewest: fewest.min(low),
            most: most.max(high),
            independent: most >= high,
        }
    }

    /// The one-sided 95 % bounds, entries an hour; `None` without judged hours.
    pub fn bounds(&self) -> Option<(f64, f64)> {
        (self.hours > 0.0).then(|| (self.fewest / self.hours, self.most / self.hours))
    }

    /// What it says about the rate `asked`, entries an hour.
    pub fn loudness(&self, asked: f64) -> Loudness {
        match self.bounds() {
            Some((_, upper)) if upper <= asked => Loudness::NotLouder,
            Some((lower, _)) if lower > asked => Loudness::Louder,
            _ => Loudness::NotShown {
                missing_hours: self.most / asked - self.hours,
            },
        }
    }

    /// The words with the bound on which they are based, or with what is missing.
    pub fn said(&self, asked: f64) -> String {
        let word = self.loudness(asked).name();
        let bounds = self
            .bounds()
            .map(|(lower, upper)| (ThreeDigits(lower), ThreeDigits(upper)));
        match (self.loudness(asked), bounds) {
            (Loudness::NotShown { .. }, bounds) => {
                let bounds = bounds.map_or_else(
                    || "nothing was judged".to_owned(),
                    |(lower, upper)| format!("{lower} to {upper} an hour (95 % each bound)"),
                );
                let missing = self.missing(asked).unwrap_or_default();
                format!("{word}: {bounds}; {missing} would show that it is not louder")
            }
            (Loudness::NotLouder, Some((_, upper))) => {
                format!("{word}: at most {upper} an hour (95 %)")
            }
            (Loudness::Louder, Some((lower, _))) => {
                format!("{word}: at least {lower} an hour (95 %)")
            }
            // Without hours, nothing is shown.
            (_, None) => word.to_owned(),
        }
    }

    /// What is missing to show that the rate is not louder than asked; `None` if nothing is missing. It says `about` if
    /// several entries came from the same drives, because their bound moves a little with more drives.
    pub fn missing(&self, asked: f64) -> Option<String> {
        let Loudness::NotShown { missing_hours } = self.loudness(asked) else {
            return None;
        };
        let about = if self.independent { "" } else { "about " };
        let more = if self.hours > 0.0 { " more" } else { "" };
        Some(format!(
            "{about}{}{more} without an entry",
            Hours(missing_hours).rounded_up()
        ))
    }
}

/// Exact two-sided 95 % interval of a rate from `events` in `hours` (Garwood 1936); without events, it is from 0 to the
/// bound at which no event has a probability of 2.5 %.
pub fn poisson_interval(events: u64, hours: f64) -> (f64, f64) {
    if hours <= 0.0 {
        return (0.0, f64::MAX);
    }
    let (fewest, most) = poisson_bounds(events, BEYOND_EACH_END);
    (fewest / hours, most / hours)
}

/// The bounds of the expectation for `events` events: below the first bound, this number or more has a probability of
/// less than `beyond`; above the second bound, this number or fewer does. The first bound is 0 without events.
#[allow(clippy::cast_precision_loss)]
fn poisson_bounds(events: u64, beyond: f64) -> (f64, f64) {
    let log_factorial = |n: u64| (1..=n).map(|i| (i as f64).ln()).sum::<f64>();
    // Probability of at most `events` events at an expectation of `mean`, summed from its last term down.
    let at_most = |events: u64, log_factorial: f64, mean: f64| -> f64 {
        let log_last = events as f64 * mean.ln() - mean - log_factorial;
        let mut term = log_last.exp();
        let mut sum = term;
        for n in (1..=events).rev() {
            term *= n as f64 / mean;
            sum += term;
            // Terms fall from here on, and no longer change the sum.
            if (n as f64) < mean && term < 1e-20 * sum {
                break;
            }
        }
        sum
    };
    let solved = |target: &dyn Fn(f64) -> bool| {
        // Not so far away that a probability underflows.
        let (most_likely, far) = (events as f64, 10.0 * (events as f64).sqrt() + 13.0);
        let (mut low, mut high) = ((most_likely - far).max(1e-9), most_likely + far);
        for _ in 0..100 {
            let middle = 0.5 * (low + high);
            if target(middle) {
                low = middle
            } else {
                high = middle
            }
        }
        0.5 * (low + high)
    };
    let of_all = log_factorial(events);
    let most = solved(&|mean| at_most(events, of_all, mean) > beyond);
    let fewest = if events == 0 {
        0.0
    } else {
        let of_fewer = log_factorial(events - 1);
        solved(&|mean| 1.0 - at_most(events - 1, of_fewer, mean) < beyond)
    };
    (fewest, most)
}

/// A duration in hours, shown in a readable unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hours(pub f64);

impl Hours {
    fn in_unit(self) -> (f64, &'static str) {
        match self.0 {
            hours if hours >= 1.0 => (hours, "hours"),
            hours if hours >= 1.0 / 60.0 => (60.0 * hours, "minutes"),
            hours => (3_600.0 * hours, "seconds"),
        }
    }

    /// The same, rounded up to the next tenth of that unit.
    fn rounded_up(self) -> String {
        let (value, unit) = self.in_unit();
        format!(
            "{:.1} {unit}",
            ((10.0 * value - 1e-9).ceil() / 10.0).max(0.1)
        )
    }
}

impl fmt::Display for Hours {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (value, unit) = self.in_unit();
        write!(f, "{value:.1} {unit}")
    }
}

/// A number from 0 on, shown with three significant digits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThreeDigits(pub f64);

impl fmt::Display for ThreeDigits {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.0 <= 0.0 {
            return f.write_str("0");
        }
        // The position of the first digit is a small number, and not negative after the clamp.
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        let decimals = (2.0 - self.0.log10().floor()).clamp(0.0, 15.0) as usize;
        write!(f, "{:.decimals$}", self.0)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn assert_near(found: f64, wanted: f64) {
        assert!((found - wanted).abs() < 1e-3, "{found}, wanted {wanted}");
    }

    #[test]
    fn intervals_of_a_rate_are_garwoods() {
        // Ulm's table: 0: 0 to 3.689; 5: 1.623 to 11.668; 10: 4.795 to 18.390.
        for (events, low, high) in [
            (0, 0.0, 3.6889),
            (5, 1.6235, 11.6683),
            (10, 4.7954, 18.3904),
        ] {
            let (found_low, found_high) = poisson_interval(events, 2.0);
            assert_near(2.0 * found_low, low);
            assert_near(2.0 * found_high, high);
        }
    }

    #[test]
    fn one_sided_bounds_leave_five_per_cent_beyond() {
        // Half of the 5 % and 95 % points of chi squared with 2n and 2n + 2 degrees of freedom.
        for (entries, fewest, most) in [
            (0, 0.0, 2.9957),
            (1, 0.0513, 4.7439),
            (7, 3.2853, 13.1481),
            (20, 13.2547, 29.0620),
        ] {
            let (lower, upper) = CountedRate::new(entries, 2.0, None).bounds().unwrap();
            assert_near(2.0 * lower, fewest);
            assert_near(2.0 * upper, most);
        }
        // For many entries, the normal distribution gives the ends: a million plus or minus 1.645 thousand.
        let (lower, upper) = CountedRate::new(1_000_000, 1.0, None).bounds().unwrap();
        assert!((998_350.0..998_361.0).contains(&lower), "{lower}");
        assert!((1_001_640.0..1_001_652.0).contains(&upper), "{upper}");
    }

    #[test]
    fn a_rate_is_louder_not_louder_or_not_shown() {
        for (entries, hours, asked, said) in [
            (
                20,
                3.0,
                1.0,
                "louder than asked: at least 4.42 an hour (95 %)",
            ),
            (
                7,
                5.0,
                1.0,
                "not shown: 0.657 to 2.63 an hour (95 % each bound); 8.2 hours more without an entry would show that it is not louder",
            ),
            (
                0,
                3.0,
                1.0,
                "not louder than asked: at most 0.999 an hour (95 %)",
            ),
            (
                0,
                2.99,
                1.0,
                "not shown: 0 to 1.00 an hour (95 % each bound); 20.7 seconds more without an entry would show that it is not louder",
            ),
            (
                0,
                0.0,
                1.0,
                "not shown: nothing was judged; 3.0 hours without an entry would show that it is not louder",
            ),
            (
                0,
                0.0,
                100.0,
                "not shown: nothing was judged; 1.8 minutes without an entry would show that it is not louder",
            ),
            (
                2,
                1_000.0,
                0.01,
                "not louder than asked: at most 0.00630 an hour (95 %)",
            ),
        ] {
            assert_eq!(CountedRate::new(entries, hours, None).said(asked), said);
        }
    }

    #[test]
    fn the_hours_that_are_missing_are_enough_and_no_fewer_are() {
        for entries in [0, 1, 7, 40] {
            let rate = CountedRate::new(entries, 5.0, None);
            let Loudness::NotShown { missing_hours } = rate.loudness(0.3) else {
                continue;
            };
            let with = |more: f64| CountedRate::new(entries, 5.0 + more, None).loudness(0.3);
            assert_eq!(with(missing_hours + 1e-6), Loudness::NotLouder);
            assert!(matches!(
                with(missing_hours - 1e-6),
                Loudness::NotShown { .. }
            ));
        }
    }

    #[test]
    fn the_wider_of_two_bounds_counts_on_either_side() {
        let alone = CountedRate::new(20, 4.0, None);
        assert_eq!(alone.loudness(3.0), Loudness::Louder);
        assert_eq!(alone.loudness(7.5), Loudness::NotLouder);
        let together = CountedRate::new(20, 4.0, Some((1.0, 9.0)));
        assert_eq!(together.bounds(), Some((1.0, 9.0)));
        assert!(matches!(together.loudness(3.0), Loudness::NotShown { .. }));
        assert_eq!(
            together.missing(7.5).unwrap(),
            "about 48.0 minutes more without an entry"
        );
        assert_eq!(CountedRate::new(20, 4.0, Some((4.9, 5.1))), alone);
    }

    #[test]
    fn no_length_of_time_reads_as_none() {
        for (hours, said, up) in [
            (15.000_000_000_037, "15.0 hours", "15.0 hours"),
            (0.5, "30.0 minutes", "30.0 minutes"),
            (0.003, "10.8 seconds", "10.8 seconds"),
            (1e-9, "0.0 seconds", "0.1 seconds"),
        ] {
            assert_eq!(Hours(hours).to_string(), said);
            assert_eq!(Hours(hours).rounded_up(), up);
        }
        for (value, said) in [
            (0.0, "0"),
            (0.001_234, "0.00123"),
            (8.416, "8.42"),
            (737.78, "738"),
            (12_345.0, "12345"),
        ] {
            assert_eq!(ThreeDigits(value).to_string(), said);
        }
    }
}
