use std::time::Duration;

use netcord_common::Stamp;
use thiserror::Error;

use super::{Command, PacketError, Status, parse_ack};

/// How long a device is waited for, and how often it is asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Patience {
    /// For an acknowledge.
    pub answer: Duration,
    /// Longest that a pending acknowledge may ask for.
    pub pending: Duration,
    /// How often a command is sent in all.
    pub attempts: u32,
}

impl Default for Patience {
    /// 500 ms until the device's own response time has been read; cameras ask for up to some seconds
    /// while they write their flash.
    fn default() -> Self {
        Self { answer: Duration::from_millis(500), pending: Duration::from_secs(10), attempts: 5 }
    }
}

/// Whether a command may be carried out twice.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Retry {
    /// Reads and settings: doing it twice is doing it once.
    Allowed,
    /// A software trigger exposes twice when it is sent twice; where its acknowledge is lost, that it
    /// was carried out is not known, and it is not sent again.
    Never,
}

/// Why an exchange failed.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum ExchangeError {
    /// The device answered with an error.
    #[error("the camera answered {0}")]
    Refused(Status),
    /// The device answered none of the attempts.
    #[error(
        "the camera did not acknowledge {attempts} attempts of {answer_ms} ms each ({stale} late answers to \
         earlier commands and {garbled} garbled packets were dropped)"
    )]
    NoAnswer {
        /// How often it was asked.
        attempts: u32,
        /// How long each was waited for.
        answer_ms: u128,
        /// Answers to earlier commands that came in the meantime.
        stale: u32,
        /// Packets that were no acknowledge.
        garbled: u32,
    },
    /// A read brought another number of bytes than asked for.
    #[error("the camera answered a read of {wanted} bytes with {found}")]
    WrongLength {
        /// Asked for.
        wanted: usize,
        /// Got.
        found: usize,
    },
}

/// What the driver must do next for an exchange.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Next {
    /// Send [`Exchange::packet`].
    Send,
    /// Receive a packet, until the instant at the latest.
    Receive {
        /// Deadline.
        until: Stamp,
    },
    /// It is done: [`Exchange::data`] holds what was read.
    Done,
}

/// One command and its acknowledge, as a state machine without I/O and clock.
///
/// Every attempt has a new request id. Acknowledges of earlier attempts or of a dead process are
/// dropped by their id; a pending acknowledge of this command restarts the clock with the time that the
/// device asks for, and the answer is taken as soon as it comes.
#[derive(Debug)]
pub struct Exchange {
    packet: Vec<u8>,
    ack_code: u16,
    expected: usize,
    request_id: u16,
    patience: Patience,
    retry: Retry,
    attempts: u32,
    stale: u32,
    garbled: u32,
    deadline: Option<Stamp>,
    data: Option<Vec<u8>>,
}

impl Exchange {
    /// An exchange of `command`, with the request id that follows `last_id`.
    pub fn new(command: &Command<'_>, last_id: u16, patience: Patience, retry: Retry) -> Self {
        let request_id = following(last_id);
        let mut packet = Vec::new();
        command.encode(request_id, &mut packet);
        Self {
            packet,
            ack_code: command.ack_code(),
            expected: command.expected_data(),
            request_id,
            patience,
            retry,
            attempts: 0,
            stale: 0,
            garbled: 0,
            deadline: None,
            data: None,
        }
    }

    /// What to do now.
    pub fn next(&self) -> Next {
        match (&self.data, self.deadline) {
            (Some(_), _) => Next::Done,
            (None, Some(until)) => Next::Receive { until },
            (None, None) => Next::Send,
        }
    }

    /// The packet to send.
    pub fn packet(&self) -> &[u8] {
        &self.packet
    }

    /// The packet has been sent.
    pub fn sent(&mut self, now: Stamp) {
        self.attempts += 1;
        self.deadline = Some(now.after(self.patience.answer));
    }

    /// A packet has come.
    ///
    /// # Errors
    /// [`ExchangeError::Refused`] and [`ExchangeError::WrongLength`].
    pub fn received(&mut self, bytes: &[u8], now: Stamp) -> Result<(), ExchangeError> {
        let ack = match parse_ack(bytes) {
            Ok(ack) => ack,
            Err(PacketError::Truncated { .. } | PacketError::Magic { .. } | PacketError::Code(_)) => {
                // What a dead process left unread, or line noise: the time-out decides.
                self.garbled += 1;
                return Ok(());
            }
        };
        if ack.request_id != self.request_id {
            self.stale += 1;
            return Ok(());
        }
        if let Some(ms) = ack.pending_ms() {
            let asked = Duration::from_millis(ms.into()).clamp(self.patience.answer, self.patience.pending);
            self.deadline = Some(now.after(asked));
            return Ok(());
        }
        if ack.status == Status::BUSY && self.may_repeat() {
            self.repeat();
            return Ok(());
        }
        if !ack.status.is_success() {
            return Err(ExchangeError::Refused(ack.status));
        }
        if ack.code != self.ack_code {
            self.garbled += 1;
            return Ok(());
        }
        if self.expected > 0 && ack.data.len() != self.expected {
            return Err(ExchangeError::WrongLength { wanted: self.expected, found: ack.data.len() });
        }
        self.data = Some(ack.data.to_vec());
        Ok(())
    }

    /// Nothing has come until the deadline, or sending failed.
    ///
    /// # Errors
    /// [`ExchangeError::NoAnswer`] when the attempts are used up.
    pub fn timed_out(&mut self) -> Result<(), ExchangeError> {
        if self.may_repeat() {
            self.repeat();
            return Ok(());
        }
        Err(ExchangeError::NoAnswer {
            attempts: self.attempts.max(1),
            answer_ms: self.patience.answer.as_millis(),
            stale: self.stale,
            garbled: self.garbled,
        })
    }

    fn may_repeat(&self) -> bool {
        self.attempts < self.patience.attempts && (self.retry == Retry::Allowed || self.attempts == 0)
    }

    fn repeat(&mut self) {
        self.request_id = following(self.request_id);
        self.packet[10..12].copy_from_slice(&self.request_id.to_le_bytes());
        self.deadline = None;
    }

    /// The id of the last attempt: where the next exchange goes on.
    pub const fn request_id(&self) -> u16 {
        self.request_id
    }

    /// What was read; empty for writes, and before the exchange is done.
    pub fn data(&self) -> &[u8] {
        self.data.as_deref().unwrap_or_default()
    }
}

/// Request ids count up and skip 0 (GenCP 4.2).
const fn following(id: u16) -> u16 {
    match id.wrapping_add(1) {
        0 => 1,
        next => next,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ack(status: u16, code: u16, id: u16, data: &[u8]) -> Vec<u8> {
        let mut b = vec![0x55, 0x33, 0x56, 0x43];
        for field in [status, code, u16::try_from(data.len()).expect("short"), id] {
            b.extend(field.to_le_bytes());
        }
        b.extend(data);
        b
    }

    fn read(retry: Retry) -> Exchange {
        Exchange::new(&Command::Read { address: 0, length: 4 }, 0xffff, Patience::default(), retry)
    }

    const T: Stamp = Stamp::from_ns(1_000_000_000);

    #[test]
    fn ids_skip_zero_and_stale_answers_are_dropped() {
        let mut exchange = read(Retry::Allowed);
        assert_eq!((exchange.next(), exchange.request_id()), (Next::Send, 1));
        exchange.sent(T);
        let until = T.after(Duration::from_millis(500));
        for noise in [ack(0, 0x801, 0xffff, &[9; 4]), ack(0, 0x803, 1, &[0; 4]), vec![1, 2, 3]] {
            exchange.received(&noise, T).expect("dropped");
            assert_eq!(exchange.next(), Next::Receive { until });
        }
        exchange.received(&ack(0, 0x801, 1, &[1, 2, 3, 4]), T).expect("the answer");
        assert_eq!((exchange.next(), exchange.data()), (Next::Done, &[1, 2, 3, 4][..]));
    }

    #[test]
    fn a_pending_acknowledge_restarts_the_clock_within_reason() {
        let mut exchange = read(Retry::Never);
        exchange.sent(T);
        exchange.received(&ack(0, 0x805, 1, &[0, 0, 0x84, 3]), T).expect("pending");
        assert_eq!(exchange.next(), Next::Receive { until: T.after(Duration::from_millis(900)) });
        exchange.received(&ack(0, 0x805, 1, &[0, 0, 0xff, 0xff]), T).expect("pending");
        assert_eq!(exchange.next(), Next::Receive { until: T.after(Duration::from_secs(10)) });
    }

    #[test]
    fn lost_answers_are_asked_for_again_but_a_trigger_is_not() {
        let mut exchange = read(Retry::Allowed);
        for attempt in 1..=4 {
            exchange.sent(T);
            exchange.timed_out().expect("again");
            assert_eq!((exchange.next(), exchange.request_id()), (Next::Send, attempt + 1));
            assert_eq!(exchange.packet()[10..12], (attempt + 1).to_le_bytes());
        }
        exchange.sent(T);
        assert!(matches!(exchange.timed_out(), Err(ExchangeError::NoAnswer { attempts: 5, .. })));
        let mut trigger = read(Retry::Never);
        trigger.sent(T);
        assert!(trigger.timed_out().is_err());
    }

    #[test]
    fn refusals_name_the_status_and_busy_is_asked_again() {
        let mut exchange = read(Retry::Allowed);
        exchange.sent(T);
        exchange.received(&ack(0x8007, 0x801, 1, &[]), T).expect("busy");
        assert_eq!(exchange.next(), Next::Send);
        exchange.sent(T);
        let error = exchange.received(&ack(0x8003, 0x801, 2, &[]), T).expect_err("refused");
        assert_eq!(error.to_string(), "the camera answered 0x8003 (invalid address)");
        let mut exchange = read(Retry::Allowed);
        exchange.sent(T);
        assert!(exchange.received(&ack(0, 0x801, 1, &[0; 3]), T).is_err(), "one byte short");
    }
}
