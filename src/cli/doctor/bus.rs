//! Whether the bus is there, and which other nodes are on it.

use std::fs;
use std::time::{Duration, Instant};

use gapwatch::can::receiver::{Heard, Receiver};
use gapwatch::can::{BusState, Sink, WarningSink};
use gapwatch::live::board::Board;

use super::check::Check;

/// How often the bus is read.
const TICK: Duration = Duration::from_millis(5);
/// Shortest time of listening: the sender of a speed may have a cycle of a second.
const LISTEN_MIN: Duration = Duration::from_millis(1_200);
/// `ARPHRD_CAN` of `linux/if_arp.h`, and `IFF_UP` of `linux/if.h`.
const IS_CAN: u64 = 280;
const IS_UP: u64 = 1;

/// What was heard on the bus.
#[derive(Default)]
struct Ears {
    foreign: Option<u16>,
    speed: Option<Option<bool>>,
}

pub fn check(board: &Board) -> Vec<Check> {
    let sink = &board.can.sink;
    let mut open = match sink.open(&board.can.settings) {
        Ok(open) => open,
        Err(error) => {
            let why = format!("{:#}", anyhow::Error::new(error));
            let remedy = match interface(sink) {
                Some(name) if sysfs(name, "").exists() => {
                    "name a CAN interface as sink in [can]".to_owned()
                }
                Some(name) if name.starts_with("vcan") => {
                    format!("ip link add {name} type vcan && ip link set {name} up")
                }
                Some(name) => format!(
                    "plug the adapter in or load its driver: {name} is not in the list of ip -br link"
                ),
                None => "name a log file in a folder that can be written to".to_owned(),
            };
            return vec![Check::fail("bus", why, remedy)];
        }
    };
    let Some(name) = interface(sink) else {
        let found = match sink {
            Sink::LogFile(path) => {
                format!("log:{}: there is no bus to listen to", path.display())
            }
            Sink::None => "none: nobody receives a warning".to_owned(),
            _ => "log:-: there is no bus to listen to".to_owned(),
        };
        return vec![Check::pass("bus", found)];
    };
    if let Some(failed) = check_interface(name) {
        return vec![failed];
    }
    let ears = listen(open.as_mut(), board);
    let ids = &board.can.settings;
    let state = open.bus_state();
    let mut checks = vec![match ears.foreign {
        None if matches!(state, BusState::Passive | BusState::Off) => Check::fail(
            "bus",
            format!("socketcan:{name}: the controller is {state:?}, after many errors on the wire"),
            "check wiring, termination and bit rate, and that there is another node to acknowledge",
        ),
        Some(id) => Check::fail(
            "bus",
            format!("socketcan:{name}: another node sends our CAN id {id:#X}"),
            "stop that node (is a monitor running?), or give this message another id in [can]",
        ),
        None => Check::pass(
            "bus",
            format!(
                "socketcan:{name} is up, controller {:?}; {:#X}, {:#X} and {:#X} are free",
                state, ids.status.id, ids.health.id, ids.version.id
            ),
        ),
    }];
    if let Some(speed) = &ids.speed {
        checks.push(match ears.speed {
            None => Check::fail(
                "speed",
                format!("no frame with CAN id {:#X} came", speed.id),
                "check with candump what the car sends, and set [can.speed]; without it the monitor does not know when the car is parked",
            ),
            Some(None) => Check::fail(
                "speed",
                format!("CAN id {:#X} comes, but its sender says that it does not know the speed", speed.id),
                "set start_bit and length in [can.speed] as the car's DBC file says",
            ),
            Some(Some(standing)) => Check::pass(
                "speed",
                format!("CAN id {:#X}: the car {}", speed.id, if standing { "is not moving" } else { "is moving" }),
            ),
        });
    }
    checks
}

fn listen(sink: &mut dyn WarningSink, board: &Board) -> Ears {
    let mut receiver = Receiver::new(&board.can.settings);
    let mut ears = Ears::default();
    let until = Instant::now() + board.can.listen.max(LISTEN_MIN);
    while Instant::now() < until {
        while let Some(frame) = sink.receive() {
            match receiver.hear(&frame) {
                Some(Heard::Foreign(id)) => ears.foreign = Some(id),
                Some(Heard::Standing(standing)) => ears.speed = Some(standing),
                _ => {}
            }
        }
        std::thread::sleep(TICK);
    }
    ears
}

/// What is wrong with an interface that can be opened.
fn check_interface(name: &str) -> Option<Check> {
    let number = |file: &str| {
        let text = fs::read_to_string(sysfs(name, file)).ok()?;
        let text = text.trim();
        text.strip_prefix("0x").map_or_else(
            || text.parse().ok(),
            |hex| u64::from_str_radix(hex, 16).ok(),
        )
    };
    let bus = |found: String, remedy: String| Some(Check::fail("bus", found, remedy));
    if number("type").is_some_and(|kind| kind != IS_CAN) {
        return bus(
            format!("{name} is not a CAN interface"),
            "name a CAN interface as sink in [can]; this lists them: ip -br link show type can"
                .to_owned(),
        );
    }
    if number("flags").is_some_and(|flags| flags & IS_UP == 0) {
        return bus(
            format!("socketcan:{name} is down"),
            format!(
                "ip link set {name} up; a controller needs its bit rate first: ip link set {name} type can bitrate 500000 restart-ms 100"
            ),
        );
    }
    if number("carrier") == Some(0) {
        return bus(
            format!("socketcan:{name} has no carrier: its controller is off the bus"),
            format!(
                "check wiring, termination and bit rate, then: ip link set {name} down; ip link set {name} type can restart-ms 100; ip link set {name} up"
            ),
        );
    }
    None
}

fn sysfs(interface: &str, file: &str) -> std::path::PathBuf {
    std::path::Path::new("/sys/class/net")
        .join(interface)
        .join(file)
}

fn interface(sink: &Sink) -> Option<&str> {
    match sink {
        #[cfg(feature = "can")]
        Sink::Socket(name) => Some(name),
        _ => None,
    }
}
