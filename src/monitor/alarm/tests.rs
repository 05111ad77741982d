use super::*;

/// Runs scores at a frame rate; `None` = cannot judge. Returns the changes of state with their times in ms.
fn changes(fps: u32, days: &[(f64, Option<f64>)]) -> Vec<(u128, AlarmState)> {
    let mut alarm = Alarm::default();
    let mut seen = vec![];
    let mut frame = 0_u32;
    let mut until = 0.0;
    for &(seconds, score) in days {
        until += seconds;
        while f64::from(frame) / f64::from(fps) < until - 1e-9 {
            let now = Duration::from_secs(frame.into()) / fps;
            let judgement = match score {
                Some(score) => Judgement::Score {
                    score,
                    settled: now >= Duration::from_secs(1),
                },
                None => Judgement::Cannot(Reason::Black),
            };
            alarm.step(now, judgement);
            if seen.last().is_none_or(|&(_, state)| state != alarm.state()) {
                seen.push((now.as_millis(), alarm.state()));
            }
            frame += 1;
        }
    }
    seen
}

#[test]
fn a_clear_road_is_ok_and_stays_so() {
    assert_eq!(
        changes(10, &[(60.0, Some(0.4))]),
        [(0, AlarmState::Init), (1_000, AlarmState::Ok)]
    );
}

#[test]
fn a_gap_is_reported_after_a_second_and_ends_two_seconds_after_the_evidence_at_any_frame_rate() {
    for fps in [5, 10, 30, 50] {
        let seen = changes(
            fps,
            &[(5.0, Some(0.1)), (5.0, Some(2.0)), (10.0, Some(0.1))],
        );
        let states: Vec<AlarmState> = seen.iter().map(|&(_, state)| state).collect();
        assert_eq!(
            states,
            [
                AlarmState::Init,
                AlarmState::Ok,
                AlarmState::Suspect,
                AlarmState::Gap,
                AlarmState::Ok
            ],
            "{fps} frames/s"
        );
        let (gap, ok) = (seen[3].0, seen[4].0);
        assert!(
            (5_700..=6_000).contains(&gap),
            "{fps} frames/s: Gap at {gap} ms"
        );
        assert!(
            (11_700..=12_050).contains(&ok),
            "{fps} frames/s: Ok at {ok} ms"
        );
    }
}

#[test]
fn a_drift_leads_to_a_gap_of_that_reason() {
    let mut alarm = Alarm::default();
    for tenth in 0..30 {
        let judgement = if tenth < 15 {
            Judgement::Score {
                score: 0.9,
                settled: tenth >= 10,
            }
        } else {
            Judgement::Drift { settled: true }
        };
        alarm.step(Duration::from_millis(100) * tenth, judgement);
    }
    assert_eq!(
        (alarm.state(), alarm.reason()),
        (AlarmState::Gap, Reason::Drift)
    );
}

#[test]
fn the_stored_bit_is_cleared_only_after_the_gap() {
    let mut alarm = Alarm::default();
    for tenth in 0..100 {
        alarm.step(
            Duration::from_millis(100) * tenth,
            Judgement::Score {
                score: if tenth < 40 { 5.0 } else { 0.0 },
                settled: true,
            },
        );
        match (tenth, alarm.state()) {
            (30, state) => {
                assert_eq!(state, AlarmState::Gap);
                assert!(!alarm.clear_stored() && alarm.gap_stored());
            }
            (99, state) => {
                assert_eq!(state, AlarmState::Ok);
                assert!(alarm.gap_stored() && alarm.clear_stored());
                assert!(!alarm.gap_stored());
            }
            _ => {}
        }
    }
}

#[test]
fn a_short_flicker_is_suspect_but_no_gap() {
    let seen = changes(10, &[(5.0, Some(0.1)), (0.4, Some(3.0)), (10.0, Some(0.1))]);
    assert!(
        seen.iter().all(|&(_, state)| state != AlarmState::Gap),
        "{seen:?}"
    );
    assert!(seen.iter().any(|&(_, state)| state == AlarmState::Suspect));
}

#[test]
fn suspicion_lasts_as_long_as_evidence_comes_and_the_counter_is_above_0() {
    // Evidence in every other frame: the counter climbs by 12.7 and falls by 6.35.
    let mut alarm = Alarm::default();
    for tenth in 0..100_u32 {
        let evident = (20..60).contains(&tenth) && tenth % 2 == 0;
        let judgement = Judgement::Score {
            score: if evident { 2.0 } else { 0.0 },
            settled: tenth >= 10,
        };
        alarm.step(Duration::from_millis(100) * tenth, judgement);
        let wanted = match tenth {
            0..10 => AlarmState::Init,
            20..56 => AlarmState::Suspect,
            56..78 => AlarmState::Gap,
            // 2 s after the last evidence, or one frame later.
            78 => continue,
            _ => AlarmState::Ok,
        };
        assert_eq!(alarm.state(), wanted, "frame {tenth}");
    }
}

#[test]
fn evidence_that_hovers_stays_suspect_and_is_no_gap() {
    // Evidence in every third frame: the counter comes back to 0 each time.
    let mut alarm = Alarm::default();
    for tenth in 0..600_u32 {
        let evident = tenth > 20 && tenth % 3 == 0;
        let judgement = Judgement::Score {
            score: if evident { 2.0 } else { 0.0 },
            settled: tenth > 10,
        };
        alarm.step(Duration::from_millis(100) * tenth, judgement);
        assert_ne!(alarm.state(), AlarmState::Gap, "frame {tenth}");
        if evident {
            assert_eq!(alarm.state(), AlarmState::Suspect, "frame {tenth}");
        }
    }
}

#[test]
fn evidence_from_before_a_hole_counts_for_nothing_behind_it() {
    let ms = Duration::from_millis;
    let judged = |score| Judgement::Score {
        score,
        settled: true,
    };
    for (hole_ms, rests) in [(501, false), (600_000, false), (600_000, true)] {
        let mut alarm = Alarm::default();
        (0..14).for_each(|tenth| alarm.step(ms(100 * tenth), judged(0.0)));
        (14..20).for_each(|tenth| alarm.step(ms(100 * tenth), judged(9.0)));
        assert_eq!(alarm.fault_detection_counter(), 76);
        let behind = 1_900 + hole_ms;
        if rests {
            alarm.rest(ms(behind));
            assert_eq!(alarm.stale_at(), Some(ms(behind + 500)));
            // A frame that cannot be judged then does not continue what was judged before.
            alarm.step(ms(behind), Judgement::Cannot(Reason::Black));
            let parked = (AlarmState::Unavailable, Reason::Parked);
            assert_eq!((alarm.state(), alarm.reason()), parked);
        }
        let mut gap_after = None;
        for tenth in 0..20 {
            alarm.step(ms(behind + 100 * tenth), judged(9.0));
            if alarm.state() == AlarmState::Gap {
                gap_after.get_or_insert(tenth);
            } else {
                assert_eq!(alarm.state(), AlarmState::Suspect);
                assert!(!alarm.gap_stored());
            }
        }
        assert_eq!(gap_after, Some(10), "hole of {hole_ms} ms");
    }
}

#[test]
fn slow_frames_add_up_and_a_gap_lasts_through_a_hole() {
    let s = Duration::from_secs;
    let judged = |score| Judgement::Score {
        score,
        settled: true,
    };
    let mut alarm = Alarm::default();
    let mut states = vec![];
    for second in 0..6 {
        alarm.step(s(second), judged(9.0));
        states.push(alarm.state());
    }
    // The first pause may be an interruption; each of the others moves the counter by half a second.
    use AlarmState::{Gap, Suspect};
    assert_eq!(states, [Suspect, Suspect, Suspect, Gap, Gap, Gap]);
    alarm.step(s(900), judged(0.0));
    assert_eq!(alarm.state(), Gap);
}

#[test]
fn what_cannot_be_judged_is_never_ok() {
    let seen = changes(10, &[(5.0, Some(0.1)), (5.0, None), (5.0, Some(0.1))]);
    assert_eq!(
        seen,
        [
            (0, AlarmState::Init),
            (1_000, AlarmState::Ok),
            (5_400, AlarmState::SensorFault),
            (10_000, AlarmState::Ok)
        ]
    );
}

#[test]
fn a_gap_is_remembered_through_a_blind_moment_and_stored_after_it() {
    let mut alarm = Alarm::default();
    let mut step = |tenth: u32, judgement| {
        alarm.step(Duration::from_millis(100) * tenth, judgement);
        (alarm.state(), alarm.gap_stored())
    };
    for tenth in 0..40 {
        step(
            tenth,
            Judgement::Score {
                score: 5.0,
                settled: true,
            },
        );
    }
    for tenth in 40..60 {
        step(tenth, Judgement::Cannot(Reason::Undefined));
    }
    assert_eq!(
        step(60, Judgement::Cannot(Reason::Undefined)),
        (AlarmState::Unavailable, true)
    );
    assert_eq!(
        step(
            61,
            Judgement::Score {
                score: 5.0,
                settled: true
            }
        ),
        (AlarmState::Gap, true)
    );
    for tenth in 62..120 {
        step(
            tenth,
            Judgement::Score {
                score: 0.0,
                settled: true,
            },
        );
    }
    assert_eq!(
        step(
            120,
            Judgement::Score {
                score: 0.0,
                settled: true
            }
        ),
        (AlarmState::Ok, true)
    );
}

#[test]
fn one_frame_of_evidence_is_no_gap_after_a_blind_moment_or_at_a_slow_rate() {
    let judged = |score| Judgement::Score {
        score,
        settled: true,
    };
    for (step_ms, blind) in [(100, true), (1_000, false), (2_000, false)] {
        let mut alarm = Alarm::default();
        let mut now = Duration::ZERO;
        let mut step = |judgement| {
            alarm.step(now, judgement);
            now += Duration::from_millis(step_ms);
            alarm.state()
        };
        for _ in 0..20 {
            step(judged(0.0));
        }
        if blind {
            for _ in 0..30 {
                step(Judgement::Cannot(Reason::Black));
            }
        }
        assert_eq!(
            step(judged(9.0)),
            AlarmState::Suspect,
            "every {step_ms} ms, blind before: {blind}"
        );
        assert_eq!(
            step(judged(0.0)),
            if blind {
                AlarmState::Ok
            } else {
                AlarmState::Suspect
            }
        );
    }
}

#[test]
fn names_are_as_documented_and_no_two_are_the_same() {
    let states = [
        (AlarmState::Init, "Init"),
        (AlarmState::Ok, "Ok"),
        (AlarmState::Suspect, "Suspect"),
        (AlarmState::Gap, "Gap"),
        (AlarmState::SensorFault, "SensorFault"),
        (AlarmState::Unavailable, "Unavailable"),
    ];
    for (state, name) in states {
        assert_eq!(state.name(), name);
    }
    let reasons = [
        (Reason::None, "none", false),
        (Reason::Starting, "starting", false),
        (Reason::Abrupt, "abrupt", false),
        (Reason::Drift, "drift", false),
        (Reason::Black, "black", true),
        (Reason::Uniform, "uniform", true),
        (Reason::TooSmall, "too-small", false),
        (Reason::Corrupt, "corrupt", true),
        (Reason::Stale, "stale", false),
        (Reason::Undefined, "undefined", false),
        (Reason::Frozen, "frozen", true),
        (Reason::Covered, "covered", true),
        (Reason::Lagging, "lagging", false),
        (Reason::Parked, "parked", false),
        (Reason::Stopped, "stopped", false),
    ];
    for (reason, name, sensor_fault) in reasons {
        assert_eq!(reason.name(), name);
        assert_eq!(reason.is_sensor_fault(), sensor_fault, "{name}");
    }
}

#[test]
fn what_is_wrong_with_a_frame_has_its_own_reason() {
    for (why, reason) in [
        (Undefined::Black, Reason::Black),
        (Undefined::Uniform, Reason::Uniform),
        (
            Undefined::TooSmall {
                width: 10,
                height: 20,
            },
            Reason::TooSmall,
        ),
        (Undefined::Corrupt(String::new()), Reason::Corrupt),
        (
            Undefined::OutOfOrder {
                number: 1,
                before: 2,
            },
            Reason::Corrupt,
        ),
        (Undefined::Frozen(STEP_MAX), Reason::Frozen),
        (Undefined::Covered { percent: 70 }, Reason::Covered),
        (Undefined::Late(STEP_MAX), Reason::Lagging),
        (Undefined::ConstantMap, Reason::Undefined),
    ] {
        assert_eq!(Reason::from(&why), reason, "{why}");
    }
}

#[test]
fn silence_is_told_after_half_a_second_or_one_and_a_half_frames() {
    let score = Judgement::Score {
        score: 0.0,
        settled: true,
    };
    let ms = Duration::from_millis;
    for (every, patience) in [(100, 500), (333, 500), (1_000, 1_500), (2_000, 3_000)] {
        let mut alarm = Alarm::with_frames_every(ms(every));
        assert_eq!(alarm.patience(), ms(patience));
        assert_eq!(alarm.stale_at(), None);
        alarm.step(ms(100), score);
        assert_eq!(alarm.stale_at(), Some(ms(100 + patience)));
        // Silence and time without sight count from the last frame, and not from when they are noticed.
        alarm.step(ms(99 + patience), Judgement::Cannot(Reason::Stale));
        assert_eq!(alarm.stale_at(), Some(ms(100 + patience)));
        assert_eq!(alarm.state(), AlarmState::Ok);
        alarm.step(ms(100 + patience), Judgement::Cannot(Reason::Stale));
        assert_eq!(alarm.state(), AlarmState::Unavailable);
        alarm.step(ms(200 + patience), Judgement::Cannot(Reason::Black));
        assert_eq!(alarm.stale_at(), Some(ms(200 + 2 * patience)));
    }
}

#[test]
fn the_counter_goes_from_its_lowest_to_its_highest_value() {
    let mut alarm = Alarm::default();
    let mut counted = vec![];
    for tenth in 0..40_u32 {
        let judgement = Judgement::Score {
            score: if tenth < 30 { 0.0 } else { 1.0 },
            settled: true,
        };
        alarm.step(Duration::from_millis(100) * tenth, judgement);
        counted.push(alarm.fault_detection_counter());
    }
    // Down by 127 in 2 s, to -128; up by 127 in 1 s, from 0.
    assert_eq!(counted[0], 0);
    assert_eq!(counted[10], -63);
    assert_eq!(counted[29], -128);
    assert_eq!(counted[30], 12);
    assert_eq!(counted[34], 63);
    assert_eq!(counted[39], 127);
}

#[test]
fn frames_that_cannot_be_judged_in_between_hold_no_gap_up() {
    // Two of three frames are lost, as with a bad cable.
    let mut alarm = Alarm::default();
    let mut gap_at = None;
    for tenth in 0..60_u32 {
        let judgement = match tenth % 3 {
            0 => Judgement::Score {
                score: if tenth < 30 { 0.0 } else { 5.0 },
                settled: true,
            },
            _ => Judgement::Cannot(Reason::Corrupt),
        };
        alarm.step(Duration::from_millis(100) * tenth, judgement);
        assert_ne!(alarm.state(), AlarmState::SensorFault, "frame {tenth}");
        if alarm.state() == AlarmState::Gap {
            gap_at.get_or_insert(tenth);
        }
    }
    // A second of evidence from the first frame with evidence, which is 30; the time that it adds begins at frame 27.
    assert_eq!(gap_at, Some(39));
    assert_eq!(alarm.state(), AlarmState::Gap);
}

#[test]
fn evidence_after_a_blind_moment_is_suspect_again_and_never_ok() {
    let mut alarm = Alarm::default();
    let mut states = vec![];
    for tenth in 0..80_u32 {
        let judgement = match tenth {
            15..60 => Judgement::Cannot(Reason::Black),
            _ => Judgement::Score {
                score: if tenth < 10 { 0.0 } else { 5.0 },
                settled: true,
            },
        };
        alarm.step(Duration::from_millis(100) * tenth, judgement);
        if tenth >= 10 && states.last() != Some(&alarm.state()) {
            states.push(alarm.state());
        }
    }
    assert_eq!(
        states,
        [
            AlarmState::Suspect,
            AlarmState::SensorFault,
            AlarmState::Suspect,
            AlarmState::Gap
        ]
    );
}

#[test]
fn blind_from_the_start_is_not_init_for_ever() {
    assert_eq!(
        changes(10, &[(5.0, None)]),
        [(0, AlarmState::Init), (500, AlarmState::SensorFault)]
    );
}

#[test]
fn blindness_between_slow_frames_is_a_hole_and_silence_is_none() {
    let ms = Duration::from_millis;
    let evident = Judgement::Score {
        score: 9.0,
        settled: true,
    };
    for (reason, counter) in [(Reason::Black, 0), (Reason::Stale, 114)] {
        let mut alarm = Alarm::default();
        alarm.step(ms(0), evident);
        alarm.step(ms(400), evident);
        assert_eq!(alarm.fault_detection_counter(), 50);
        alarm.step(ms(900), Judgement::Cannot(reason));
        assert_eq!(alarm.reason(), reason);
        // At most one and a half times 400 ms: the frames are continuous, without an interruption between them.
        alarm.step(ms(910), evident);
        assert_eq!(alarm.fault_detection_counter(), counter, "{reason:?}");
    }
}
