//! A CAN socket of Linux in the place of the log.
//!
//! Owns the socket: it never blocks, and it is opened again when the interface comes back. Refuses to give up: a bus that
//! is down, full, unplugged or off refuses frames, and the sender keeps and counts them. In bus-off the kernel goes on
//! taking frames and loses them, so nothing is written then. How the controller stands is heard from its error frames and
//! asked for over netlink.

use std::fs;
use std::io;
use std::sync::mpsc::{Receiver, channel};
use std::thread;
use std::time::Duration;

use socketcan::nl::CanState;
use socketcan::{
    CanErrorFrame, CanFdFrame, CanFdSocket, CanFilter, CanInterface, CanSocket, EmbeddedFrame, Id,
    Socket, SocketOptions, StandardId,
};

use super::{BusState, CanFrame, LARGEST_ID, SinkError, WarningSink};

/// Time between two attempts to open a socket on an interface that has gone.
const REOPEN: Duration = Duration::from_millis(200);

/// Time between two questions over netlink how the controller stands.
const ASK: Duration = Duration::from_secs(1);

/// Kinds of error frames that are listened for, and what the second data byte of a controller's says (`linux/can/error.h`).
const CONTROLLER: u32 = 0x04;
const BUS_OFF: u32 = 0x40;
const RESTARTED: u32 = 0x100;
const NEAR_WARNING: u8 = 0x04 | 0x08;
const NEAR_PASSIVE: u8 = 0x10 | 0x20;
const ACTIVE: u8 = 0x40;

/// Bits of a socket's filter that tell extended and remote frames from standard data frames (`linux/can.h`).
const NOT_STANDARD_DATA: u32 = 0xC000_0000;

/// Sends to an interface and hears the frames with some identifiers.
pub struct SocketSink {
    /// As the user gave it, for messages.
    name: String,
    interface: String,
    heard: Vec<u16>,
    socket: Option<CanSocket>,
    /// For frames of CAN FD, while there is a way for them.
    fd_socket: Option<CanFdSocket>,
    /// How the controller stands by netlink.
    answers: Receiver<Option<BusState>>,
    /// Drive time before which the socket is not opened again, and a bus that is off is not looked at again.
    reopen_at: Duration,
    state: BusState,
}

impl SocketSink {
    /// Opens `interface`, which may be down but must be there, and hears the identifiers `heard`; with `fd` it must be able
    /// to send frames of CAN FD.
    ///
    /// # Errors
    /// [`SinkError::Open`] when there is no such CAN interface, or it has no CAN FD.
    pub fn open(interface: &str, heard: &[u16], fd: bool) -> Result<Self, SinkError> {
        let name = format!("socketcan:{interface}");
        let opened = socket(interface, heard).and_then(|socket| {
            let fd_socket = fd.then(|| fd_socket(interface)).transpose()?;
            Ok((socket, fd_socket, ask(interface)?))
        });
        match opened {
            Ok((socket, fd_socket, answers)) => Ok(Self {
                name,
                interface: interface.to_owned(),
                heard: heard.to_vec(),
                socket: Some(socket),
                fd_socket,
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

    fn write(&mut self, at: Duration, frame: &CanFrame) -> io::Result<()> {
        if self.state == BusState::Off {
            let off = || io::Error::other("it is off the bus after too many errors");
            if at < self.reopen_at {
                return Err(off());
            }
            self.reopen_at = at + REOPEN;
            if carrier(&self.interface) == Some(false) {
                return Err(off());
            }
            self.hear_state(BusState::Unknown);
        }
        if self.socket.is_none() {
            if at < self.reopen_at {
                return Err(io::ErrorKind::NotConnected.into());
            }
            self.reopen_at = at + REOPEN;
            self.socket = Some(socket(&self.interface, &self.heard)?);
            log::warn!("{}: the interface is back", self.name);
        }
        let id = StandardId::new(frame.id).ok_or(io::ErrorKind::InvalidInput)?;
        let Some((socket, frame)) = self
            .socket
            .as_ref()
            .zip(socketcan::CanFrame::new(id, &frame.data))
        else {
            return Err(io::ErrorKind::InvalidInput.into());
        };
        let taken = socket.write_frame(&frame);
        // An interface that is down or full keeps its socket; one that was deleted or unplugged needs a new one.
        if let Err(error) = &taken
            && error.kind() != io::ErrorKind::WouldBlock
            && !is_passing(error)
        {
            self.socket = None;
            self.reopen_at = at + REOPEN;
        }
        taken
    }

    fn write_fd(&mut self, id: u16, data: &[u8]) -> io::Result<()> {
        // Whether the bus is there is found out by the frames that every car needs.
        if self.socket.is_none() || self.state == BusState::Off {
            return Ok(());
        }
        if self.fd_socket.is_none() {
            self.fd_socket = Some(fd_socket(&self.interface)?);
        }
        let frame = StandardId::new(id).and_then(|id| CanFdFrame::new(id, data));
        let frame = frame.ok_or(io::ErrorKind::InvalidInput)?;
        let taken = (self.fd_socket.as_ref()).map_or(Ok(()), |socket| socket.write_frame(&frame));
        if let Err(error) = &taken
            && error.kind() != io::ErrorKind::WouldBlock
            && !is_passing(error)
        {
            self.fd_socket = None;
        }
        taken
    }

    fn hear_answers(&mut self) {
        while let Ok(answer) = self.answers.try_recv() {
            // An answer may be older than the error frame that told of bus-off.
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

/// Asks the kernel how the controller stands, now and then, for as long as somebody hears the answers; on a thread of its own,
/// since the kernel lets who asks wait for whoever sets up any interface. A virtual bus has no controller.
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
            // Down or asleep, or the interface has gone: sending finds that out.
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

/// Whether the interface has a carrier: without one its controller is off the bus. `None` when it is down or gone.
fn carrier(interface: &str) -> Option<bool> {
    let said = fs::read_to_string(format!("/sys/class/net/{interface}/carrier"));
    said.ok().map(|said| said.trim() == "1")
}

/// What an error frame says of the controller, if it says anything.
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
    const ENOBUFS: i32 = 105;
    matches!(
        error.kind(),
        io::ErrorKind::NetworkDown | io::ErrorKind::Interrupted
    ) || error.raw_os_error() == Some(ENOBUFS)
}

fn socket(interface: &str, heard: &[u16]) -> io::Result<CanSocket> {
    let socket = CanSocket::open(interface)?;
    socket.set_nonblocking(true)?;
    let mask = u32::from(LARGEST_ID) | NOT_STANDARD_DATA;
    let filters: Vec<CanFilter> = heard
        .iter()
        .map(|&id| CanFilter::new(id.into(), mask))
        .collect();
    socket.set_filters(&filters)?;
    socket.set_error_filter(CONTROLLER | BUS_OFF | RESTARTED)?;
    Ok(socket)
}

/// Sends frames of CAN FD and hears none.
fn fd_socket(interface: &str) -> io::Result<CanFdSocket> {
    const CLASSIC: &str = "16";
    let mtu = fs::read_to_string(format!("/sys/class/net/{interface}/mtu"));
    if mtu.is_ok_and(|mtu| mtu.trim() == CLASSIC) {
        return Err(io::Error::other(
            "it has no CAN FD; wanted `ip link set IFACE type can ... fd on` (of a virtual one `ip link set IFACE mtu 72`), or no fd = true in [can]",
        ));
    }
    let socket = CanFdSocket::open(interface)?;
    socket.set_nonblocking(true)?;
    socket.set_filter_drop_all()?;
    Ok(socket)
}

impl WarningSink for SocketSink {
    fn send(&mut self, at: Duration, frame: &CanFrame) -> Result<(), SinkError> {
        self.hear_answers();
        self.write(at, frame).map_err(|source| SinkError::Refused {
            sink: self.name.clone(),
            source,
        })
    }

    fn send_fd(&mut self, _at: Duration, id: u16, data: &[u8]) -> Result<(), SinkError> {
        self.write_fd(id, data)
            .map_err(|source| SinkError::Refused {
                sink: self.name.clone(),
                source,
            })
    }

    fn bus_state(&self) -> BusState {
        self.state
    }

    fn receive(&mut self) -> Option<CanFrame> {
        self.hear_answers();
        loop {
            match self.socket.as_ref()?.read_frame() {
                Ok(socketcan::CanFrame::Error(frame)) => {
                    if let Some(state) = state_of(&frame) {
                        self.hear_state(state);
                    }
                }
                Ok(frame) => {
                    if let Id::Standard(id) = frame.id() {
                        // A shorter frame ends in ones: what lies beyond its end is not known, and never a speed of 0.
                        let mut data = [0xFF; 8];
                        data.iter_mut()
                            .zip(frame.data())
                            .for_each(|(to, from)| *to = *from);
                        let id = id.as_raw();
                        return Some(CanFrame { id, data });
                    }
                }
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                // Nothing there, or an interface that is down: what to do about that is found out by sending.
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
        let refusal = SocketSink::open("nocan7", &[0x5D8], false).err().unwrap();
        assert!(matches!(refusal, SinkError::Open { .. }));
        assert!(refusal.to_string().contains("socketcan:nocan7"));
    }

    #[test]
    fn down_and_full_are_passing_and_unplugged_is_not() {
        let (enobufs, enetdown, enodev, enxio) = (105, 100, 19, 6);
        assert!(is_passing(&io::Error::from_raw_os_error(enobufs)));
        assert!(is_passing(&io::Error::from_raw_os_error(enetdown)));
        assert!(!is_passing(&io::Error::from_raw_os_error(enodev)));
        assert!(!is_passing(&io::Error::from_raw_os_error(enxio)));
    }
}
