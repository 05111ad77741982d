//! A CAN socket of Linux.
//!
//! It manages the sockets: they never block, and are opened again when the interface comes back. It never gives up: a
//! bus that is down, full, unplugged or off refuses frames, and the sender offers newer ones. In bus-off the kernel
//! would still accept frames and lose them, so nothing is written then. The state of the controller comes from its
//! error frames and from netlink.
//!
//! A frame in the kernel's queue cannot be taken back, and becomes old there while no other node acknowledges.
//! Therefore one frame at a time is handed over. If the driver echoes the frames that it has sent (`IFF_ECHO`), the
//! next frame is written after the echo of the one before was received. Otherwise it is written as long as the socket's
//! send buffer, made as small as Linux allows, is less than half full, which is two to three frames.

use std::fs;
use std::io;
use std::sync::mpsc::{Receiver, channel};
use std::thread;
use std::time::Duration;

use heapless::Deque;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use socketcan::nl::CanState;
use socketcan::{
    CanAnyFrame, CanErrorFrame, CanFdFrame, CanFdSocket, CanFilter, CanInterface, CanSocket,
    EmbeddedFrame, Id, Socket, SocketOptions, StandardId,
};

use super::{BusState, CanFrame, LARGEST_ID, SinkError, WarningSink};

/// Time between two attempts to open a socket on an interface that has gone.
const REOPEN: Duration = Duration::from_millis(200);

/// Time between two requests over netlink for the state of the controller.
const ASK: Duration = Duration::from_secs(1);

/// An echo that has not come for this long was lost, unless the controller reports that no node acknowledges. It is
/// long enough for any queue that moves.
const ECHO_LOST: Duration = Duration::from_secs(5);
/// Largest number of frames of other nodes on our identifiers that are kept until they are asked for.
const FOREIGN_MAX: usize = 4;
/// Bit of an interface's flags that says that its driver echoes the frames that it has sent (`linux/if.h`).
const IFF_ECHO: u32 = 1 << 18;
/// Level and name of the option for the size of a socket's send buffer (`asm-generic/socket.h`).
const SEND_BUFFER: (i32, i32) = (1, 7);

/// Kinds of error frames that are received, and the meaning of the second data byte of a controller's error frame
/// (`linux/can/error.h`).
const CONTROLLER: u32 = 0x04;
const BUS_OFF: u32 = 0x40;
const RESTARTED: u32 = 0x100;
const NEAR_WARNING: u8 = 0x04 | 0x08;
const NEAR_PASSIVE: u8 = 0x10 | 0x20;
const ACTIVE: u8 = 0x40;

/// Bits of a socket's filter that distinguish extended and remote frames from standard data frames (`linux/can.h`).
const NOT_STANDARD_DATA: u32 = 0xC000_0000;

/// The identifiers that a socket receives.
#[derive(Clone, Debug)]
pub struct Heard {
    /// Identifiers that other nodes send.
    pub others: Vec<u16>,
    /// Identifiers that the monitor sends.
    pub own: Vec<u16>,
}

/// Sends to an interface, and receives the frames with some identifiers.
pub struct SocketSink {
    /// As the user gave it, for messages.
    name: String,
    interface: String,
    heard: Heard,
    fd: bool,
    sockets: Option<Sockets>,
    in_flight: Option<InFlight>,
    /// Frames of other nodes that were found among the echoes of our frames.
    foreign: Deque<CanFrame, FOREIGN_MAX>,
    /// State of the controller from netlink.
    answers: Receiver<Option<BusState>>,
    /// Drive time before which the sockets are not opened again, and a bus that is off is not checked again.
    reopen_at: Duration,
    state: BusState,
}

/// What is open while the interface is there.
struct Sockets {
    /// Receives frames of other nodes, and the state of the controller.
    others: CanSocket,
    /// Sends, and receives frames with our own identifiers.
    own: Own,
    /// Whether frames come back when they have left.
    echoes: bool,
}

/// A socket for the kind of frames that the interface can send.
enum Own {
    Classic(CanSocket),
    Fd(CanFdSocket),
}

/// A frame that was handed over, and when.
struct InFlight {
    since: Duration,
    id: u16,
    data: heapless::Vec<u8, 64>,
}

impl SocketSink {
    /// Opens `interface`, which may be down but must exist, and receives the identifiers `heard`. With `fd`, it must be
    /// able to send frames of CAN FD.
    ///
    /// # Errors
    /// [`SinkError::Open`] when there is no such CAN interface, or it has no CAN FD.
    pub fn open(interface: &str, heard: Heard, fd: bool) -> Result<Self, SinkError> {
        let name = format!("socketcan:{interface}");
        let opened =
            Sockets::open(interface, &heard, fd).and_then(|sockets| Ok((sockets, ask(interface)?)));
        match opened {
            Ok((sockets, answers)) => Ok(Self {
                name,
                interface: interface.to_owned(),
                heard,
                fd,
                sockets: Some(sockets),
                in_flight: None,
                foreign: Deque::new(),
                answers,
                reopen_at: Duration::ZERO,
                state: if carrier(interface) == Some(false) {
                    BusState::Off
                } else {
                    BusState::Unknown
                },
            }),
            Err(source) => Err(SinkError::Open { sink: name, source }),
        }
    }

    fn write(&mut self, at: Duration, id: u16, data: &[u8], fd: bool) -> io::Result<()> {
        if self.state == BusState::Off {
            let off = || io::Error::other("the controller is in bus-off after too many errors");
            if at < self.reopen_at {
                return Err(off());
            }
            self.reopen_at = at + REOPEN;
            if carrier(&self.interface) == Some(false) {
                return Err(off());
            }
            self.hear_state(BusState::Unknown);
        }
        if self.sockets.is_none() {
            if at < self.reopen_at {
                return Err(io::ErrorKind::NotConnected.into());
            }
            self.reopen_at = at + REOPEN;
            self.sockets = Some(Sockets::open(&self.interface, &self.heard, self.fd)?);
            log::warn!("{}: the interface is back", self.name);
        }
        let Some(sockets) = &self.sockets else {
            return Err(io::ErrorKind::NotConnected.into());
        };
        let taken = sockets.write(id, data, fd);
        match &taken {
            Ok(()) if sockets.echoes => {
                self.in_flight = Some(InFlight {
                    since: at,
                    id,
                    data: data.iter().copied().collect(),
                });
            }
            // An interface that is down or full keeps its sockets; one that was deleted or unplugged needs new ones.
            Err(error) if error.kind() != io::ErrorKind::WouldBlock && !is_passing(error) => {
                self.sockets = None;
                self.reopen_at = at + REOPEN;
            }
            _ => {}
        }
        taken
    }

    /// Receives the echoes of our frames. Frames of other nodes on our identifiers are kept for
    /// [`WarningSink::receive`].
    fn hear_own(&mut self) {
        let Some(sockets) = &self.sockets else {
            self.in_flight = None;
            return;
        };
        loop {
            match sockets.read_own() {
                Ok((id, data)) => {
                    let is_ours = |sent: &InFlight| sent.id == id && sent.data == data;
                    if self.in_flight.as_ref().is_some_and(is_ours) {
                        self.in_flight = None;
                    } else if let Some(id) = StandardId::new(id) {
                        // One of many is enough for an error message.
                        let _ = self.foreign.push_back(classic(id, &data));
                    }
                }
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return,
                // An interface that goes down or disappears loses the frames that it was to send.
                Err(_) => {
                    self.in_flight = None;
                    return;
                }
            }
        }
    }

    fn hear_answers(&mut self) {
        while let Ok(answer) = self.answers.try_recv() {
            // An answer may be older than the error frame that reported bus-off.
            let is_old = self.state == BusState::Off && carrier(&self.interface) == Some(false);
            if let Some(state) = answer.filter(|_| !is_old) {
                self.hear_state(state);
            }
        }
    }

    fn hear_state(&mut self, state: BusState) {
        if state != self.state {
            log::warn!("{}: {:?} -> {state:?}", self.name, self.state);
            self.state = state;
        }
    }
}

/// Asks the kernel regularly for the state of the controller, as long as the answers have a receiver. This runs on a
/// thread of its own, because the kernel makes it wait while any program sets up any interface. A virtual bus has no
/// controller.
fn ask(interface: &str) -> io::Result<Receiver<Option<BusState>>> {
    let (sender, answers) = channel();
    let interface = interface.to_owned();
    let asking = move || loop {
        let state = CanInterface::open(&interface).and_then(|interface| interface.state());
        let answer = match state {
            Ok(Some(CanState::ErrorActive)) => Some(BusState::Active),
            Ok(Some(CanState::ErrorWarning)) => Some(BusState::Warning),
            Ok(Some(CanState::ErrorPassive)) => Some(BusState::Passive),
            Ok(Some(CanState::BusOff)) => Some(BusState::Off),
            // The interface is down, asleep or gone: sending will detect that.
            Ok(Some(CanState::Stopped | CanState::Sleeping) | None) | Err(_) => None,
        };
        if sender.send(answer).is_err() {
            return;
        }
        thread::sleep(ASK);
    };
    thread::Builder::new()
        .name("can-state".to_owned())
        .spawn(asking)?;
    Ok(answers)
}

/// Whether the interface has a carrier; without it, its controller is in bus-off. `None` if the interface is down or
/// gone.
fn carrier(interface: &str) -> Option<bool> {
    let said = fs::read_to_string(format!("/sys/class/net/{interface}/carrier"));
    said.ok().map(|said| said.trim() == "1")
}

/// What an error frame says about the controller, if it says anything.
fn state_of(frame: &CanErrorFrame) -> Option<BusState> {
    let bits = frame.error_bits();
    let controller = frame
        .data()
        .get(1)
        .copied()
        .filter(|_| bits & CONTROLLER != 0);
    let says = |any: u8| controller.is_some_and(|byte| byte & any != 0);
    if bits & BUS_OFF != 0 {
        Some(BusState::Off)
    } else if says(NEAR_PASSIVE) {
        Some(BusState::Passive)
    } else if says(NEAR_WARNING) {
        Some(BusState::Warning)
    } else if says(ACTIVE) || bits & RESTARTED != 0 {
        Some(BusState::Active)
    } else {
        None
    }
}

/// Down (ENETDOWN), full (ENOBUFS) or interrupted.
fn is_passing(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        io::ErrorKind::NetworkDown | io::ErrorKind::Interrupted
    ) || error.raw_os_error() == Some(Errno::NOBUFS.raw_os_error())
}

impl Sockets {
    fn open(interface: &str, heard: &Heard, fd: bool) -> io::Result<Self> {
        let others = set_up(CanSocket::open(interface)?, &heard.others)?;
        others.set_error_filter(CONTROLLER | BUS_OFF | RESTARTED)?;
        let echoes = echoes(interface);
        let own = if fd {
            has_fd(interface)?;
            let socket = set_up(CanFdSocket::open(interface)?, &heard.own)?;
            Own::Fd(set_up_own(socket, echoes)?)
        } else {
            let socket = set_up(CanSocket::open(interface)?, &heard.own)?;
            Own::Classic(set_up_own(socket, echoes)?)
        };
        Ok(Self {
            others,
            own,
            echoes,
        })
    }

    fn write(&self, id: u16, data: &[u8], fd: bool) -> io::Result<()> {
        let invalid = || io::Error::from(io::ErrorKind::InvalidInput);
        let id = StandardId::new(id).ok_or_else(invalid)?;
        let frame = || socketcan::CanFrame::new(id, data).ok_or_else(invalid);
        match &self.own {
            Own::Fd(socket) if fd => {
                socket.write_frame(&CanFdFrame::new(id, data).ok_or_else(invalid)?)
            }
            Own::Fd(socket) => socket.write_frame(&frame()?),
            Own::Classic(socket) => socket.write_frame(&frame()?),
        }
    }

    /// The next frame on one of our identifiers, whoever sent it.
    fn read_own(&self) -> io::Result<(u16, heapless::Vec<u8, 64>)> {
        loop {
            let frame: CanAnyFrame = match &self.own {
                Own::Fd(socket) => socket.read_frame()?,
                Own::Classic(socket) => socket.read_frame()?.into(),
            };
            let (id, data) = match &frame {
                CanAnyFrame::Normal(frame) => (frame.id(), frame.data()),
                CanAnyFrame::Fd(frame) => (frame.id(), frame.data()),
                CanAnyFrame::Remote(_) | CanAnyFrame::Error(_) => continue,
            };
            if let Id::Standard(id) = id {
                return Ok((id.as_raw(), data.iter().copied().collect()));
            }
        }
    }

    /// Whether few enough frames are on their way.
    fn has_room(&self) -> bool {
        let mut own = [match &self.own {
            Own::Fd(socket) => PollFd::new(socket, PollFlags::OUT),
            Own::Classic(socket) => PollFd::new(socket, PollFlags::OUT),
        }];
        let now = Timespec::default();
        // For an interface that is down, writing returns a better error.
        !matches!(poll(&mut own, Some(&now)), Ok(0))
    }
}

/// A received frame. A shorter one is filled up with ones, because the bits after its end are not known, and must not
/// become a speed of 0.
fn classic(id: StandardId, data: &[u8]) -> CanFrame {
    let mut whole = [0xFF; 8];
    whole
        .iter_mut()
        .zip(data)
        .for_each(|(to, from)| *to = *from);
    CanFrame {
        id: id.as_raw(),
        data: whole,
    }
}

/// Whether the interface's driver reports when a frame has left.
fn echoes(interface: &str) -> bool {
    let flags = fs::read_to_string(format!("/sys/class/net/{interface}/flags"));
    let flags = flags.ok().and_then(|flags| {
        let digits = flags.trim().strip_prefix("0x")?;
        u32::from_str_radix(digits, 16).ok()
    });
    flags.is_some_and(|flags| flags & IFF_ECHO != 0)
}

/// Sets up a socket that never blocks, and that receives only standard data frames with these identifiers.
fn set_up<S: Socket + SocketOptions>(socket: S, heard: &[u16]) -> io::Result<S> {
    socket.set_nonblocking(true)?;
    let mask = u32::from(LARGEST_ID) | NOT_STANDARD_DATA;
    let filter = |&id: &u16| CanFilter::new(id.into(), mask);
    let filters: Vec<CanFilter> = heard.iter().map(filter).collect();
    socket.set_filters(&filters)?;
    Ok(socket)
}

/// Sets up a socket that receives its own frames if they are echoed, and that lets as few frames as possible wait.
fn set_up_own<S: SocketOptions>(socket: S, echoes: bool) -> io::Result<S> {
    socket.set_error_filter_drop_all()?;
    socket.set_recv_own_msgs(echoes)?;
    let (level, name) = SEND_BUFFER;
    socket.set_socket_option_int(level, name, 0)?;
    Ok(socket)
}

fn has_fd(interface: &str) -> io::Result<()> {
    const CLASSIC: &str = "16";
    let mtu = fs::read_to_string(format!("/sys/class/net/{interface}/mtu"));
    if mtu.is_ok_and(|mtu| mtu.trim() == CLASSIC) {
        return Err(io::Error::other(
            "it has no CAN FD; wanted `ip link set IFACE type can ... fd on` (for a virtual interface `ip link set IFACE mtu 72`), or no fd = true in [can]",
        ));
    }
    Ok(())
}

impl WarningSink for SocketSink {
    fn send(&mut self, at: Duration, frame: &CanFrame) -> Result<(), SinkError> {
        self.hear_answers();
        let taken = self.write(at, frame.id, &frame.data, false);
        taken.map_err(|source| SinkError::Refused {
            sink: self.name.clone(),
            source,
        })
    }

    fn send_fd(&mut self, at: Duration, id: u16, data: &[u8]) -> Result<(), SinkError> {
        let taken = self.write(at, id, data, true);
        taken.map_err(|source| SinkError::Refused {
            sink: self.name.clone(),
            source,
        })
    }

    fn is_ready(&mut self, now: Duration) -> bool {
        self.hear_own();
        let old = |sent: &InFlight| now.saturating_sub(sent.since) >= ECHO_LOST;
        if self.in_flight.as_ref().is_some_and(old) && self.state != BusState::Passive {
            log::warn!(
                "{}: its driver did not report that a frame has left",
                self.name
            );
            self.in_flight = None;
        }
        let has_room = self.sockets.as_ref().is_none_or(Sockets::has_room);
        self.in_flight.is_none() && has_room
    }

    fn bus_state(&self) -> BusState {
        self.state
    }

    fn receive(&mut self) -> Option<CanFrame> {
        self.hear_answers();
        self.hear_own();
        if let Some(frame) = self.foreign.pop_front() {
            return Some(frame);
        }
        loop {
            match self.sockets.as_ref()?.others.read_frame() {
                Ok(socketcan::CanFrame::Error(frame)) => {
                    if frame.error_bits() & (BUS_OFF | RESTARTED) != 0 {
                        // The controller loses the frames that it was to send.
                        self.in_flight = None;
                    }
                    if let Some(state) = state_of(&frame) {
                        self.hear_state(state);
                    }
                }
                Ok(frame) => {
                    if let Id::Standard(id) = frame.id() {
                        return Some(classic(id, frame.data()));
                    }
                }
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                // There is no frame, or the interface is down: sending will detect that.
                Err(_) => return None,
            }
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn error_frames_say_how_the_controller_stands() {
        let frame = |bits, says| {
            let data = [0, says, 0, 0, 0, 0, 0, 0];
            state_of(&CanErrorFrame::new_error(bits, &data).unwrap())
        };
        assert_eq!(frame(BUS_OFF, 0), Some(BusState::Off));
        assert_eq!(frame(RESTARTED, 0), Some(BusState::Active));
        assert_eq!(frame(CONTROLLER, 0x08), Some(BusState::Warning));
        assert_eq!(frame(CONTROLLER, 0x24), Some(BusState::Passive));
        assert_eq!(frame(CONTROLLER, 0x40), Some(BusState::Active));
        // Full buffers and single errors on the wire change nothing.
        assert_eq!(frame(CONTROLLER, 0x02), None);
        assert_eq!(frame(0x88, 0x40), None);
    }

    #[test]
    fn an_interface_that_is_not_there_is_named() {
        let refusal = SocketSink::open(
            "nocan7",
            Heard {
                others: vec![0x5D8],
                own: vec![0x5D0],
            },
            false,
        )
        .err()
        .unwrap();
        assert!(matches!(refusal, SinkError::Open { .. }));
        assert!(refusal.to_string().contains("socketcan:nocan7"));
    }

    #[test]
    fn while_the_interface_is_away_frames_of_both_kinds_are_refused() {
        // So their counters do not change.
        for state in [BusState::Unknown, BusState::Off] {
            let (_, answers) = channel();
            let mut sink = SocketSink {
                name: "socketcan:nocan7".to_owned(),
                interface: "nocan7".to_owned(),
                heard: Heard {
                    others: vec![0x5D8],
                    own: vec![0x5D0, 0x5D2],
                },
                fd: true,
                sockets: None,
                in_flight: None,
                foreign: Deque::new(),
                answers,
                reopen_at: Duration::ZERO,
                state,
            };
            let frame = CanFrame {
                id: 0x5D0,
                data: [0; 8],
            };
            for at in [0, 100, 300].map(Duration::from_millis) {
                assert!(sink.is_ready(at));
                let refused = [sink.send(at, &frame), sink.send_fd(at, 0x5D2, &[0; 24])];
                for refused in refused {
                    assert!(
                        matches!(refused, Err(SinkError::Refused { .. })),
                        "{refused:?} at {at:?}"
                    );
                }
            }
        }
    }

    #[test]
    fn down_and_full_are_passing_and_unplugged_is_not() {
        for errno in [Errno::NOBUFS, Errno::NETDOWN] {
            assert!(is_passing(&errno.into()), "{errno}");
        }
        for errno in [Errno::NODEV, Errno::NXIO] {
            assert!(!is_passing(&errno.into()), "{errno}");
        }
    }
}
