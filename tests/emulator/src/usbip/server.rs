use std::{
    collections::VecDeque,
    io::{self, Read, Write},
    net::{Shutdown, TcpListener, TcpStream},
    sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError},
    thread,
    time::{Duration, Instant},
};

use super::wire::{
    ECONNRESET, EOVERFLOW, EPIPE, REP_DEVLIST, REP_IMPORT, REQ_DEVLIST, REQ_IMPORT, Request, bus_id,
    device_record, operation_head, read_request, submit_reply, unlink_reply,
};
use crate::{Descriptors, Rig, UrbEnd, descriptors::endpoints};

/// A USB/IP server for the cameras of a rig.
#[derive(Debug, Clone)]
pub struct Server {
    shared: Arc<Shared>,
}

#[derive(Debug)]
struct Shared {
    state: Mutex<State>,
    changed: Condvar,
    epoch: Instant,
}

#[derive(Debug)]
struct State {
    rig: Rig,
    ports: Vec<Port>,
}

/// What a camera's connection needs.
#[derive(Debug)]
struct Port {
    descriptors: Descriptors,
    connection: Option<TcpStream>,
    /// Which connection it is: an older one's thread must not touch a newer one.
    generation: u64,
    /// URBs that wait for an acknowledge.
    acks: VecDeque<u32>,
    urbs: Vec<u32>,
}

impl Server {
    /// A server for `rig`; its clock starts now.
    pub fn new(rig: Rig) -> Self {
        let ports = rig
            .cameras
            .iter()
            .map(|camera| Port {
                descriptors: Descriptors::new(camera.config()),
                connection: None,
                generation: 0,
                acks: VecDeque::new(),
                urbs: Vec::new(),
            })
            .collect();
        let state = Mutex::new(State { rig, ports });
        Self { shared: Arc::new(Shared { state, changed: Condvar::new(), epoch: Instant::now() }) }
    }

    /// Serves connections until the listener fails.
    ///
    /// # Errors
    /// Those of accepting connections.
    pub fn serve(&self, listener: &TcpListener) -> io::Result<()> {
        let clock = self.clone();
        thread::spawn(move || clock.shared.run_clock());
        loop {
            let (stream, _) = listener.accept()?;
            stream.set_nodelay(true)?;
            let shared = self.shared.clone();
            // A connection that ends is a cable that is pulled.
            thread::spawn(move || shared.connection(stream));
        }
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn now(&self) -> u64 {
        u64::try_from(self.epoch.elapsed().as_nanos()).unwrap_or(u64::MAX)
    }

    /// Lets exposures happen when they are due.
    fn run_clock(&self) {
        let mut state = self.lock();
        loop {
            let now = self.now();
            state.step(now);
            let due = state.rig.cameras.iter().filter_map(|c| c.next_after(now)).min();
            let wait = due
                .map_or(Duration::from_secs(1), |due| Duration::from_nanos(due.saturating_sub(self.now())));
            state = self.changed.wait_timeout(state, wait).map_or_else(|e| e.into_inner().0, |(s, _)| s);
        }
    }

    fn connection(&self, mut stream: TcpStream) {
        let mut head = [0; 8];
        if stream.read_exact(&mut head).is_err() {
            return;
        }
        match u16::from_be_bytes([head[2], head[3]]) {
            REQ_DEVLIST => {
                let _ = self.list(&mut stream);
            }
            REQ_IMPORT => {
                let _ = self.import(stream);
            }
            _ => {}
        }
    }

    fn list(&self, stream: &mut TcpStream) -> io::Result<()> {
        let state = self.lock();
        let mut out = operation_head(REP_DEVLIST, 0);
        out.extend(u32::try_from(state.ports.len()).unwrap_or(0).to_be_bytes());
        for (index, camera) in state.rig.cameras.iter().enumerate() {
            out.extend(device_record(index, camera.config()));
            out.extend([0xEF, 5, 0, 0, 0xEF, 5, 2, 0]);
        }
        drop(state);
        stream.write_all(&out)
    }

    fn import(&self, mut stream: TcpStream) -> io::Result<()> {
        let mut wanted = [0; 32];
        stream.read_exact(&mut wanted)?;
        let wanted = String::from_utf8_lossy(&wanted).trim_end_matches('\0').to_owned();
        let (index, generation) = {
            let mut state = self.lock();
            let free = state
                .ports
                .iter()
                .enumerate()
                .position(|(i, port)| bus_id(i) == wanted && port.connection.is_none());
            let Some(index) = free else { return stream.write_all(&operation_head(REP_IMPORT, 1)) };
            let mut out = operation_head(REP_IMPORT, 0);
            out.extend(device_record(index, state.rig.cameras[index].config()));
            stream.write_all(&out)?;
            let port = &mut state.ports[index];
            port.connection = Some(stream.try_clone()?);
            port.generation += 1;
            (index, port.generation)
        };
        let result = self.serve_device(&mut stream, index);
        let mut state = self.lock();
        if state.ports[index].generation == generation {
            state.unplug(index);
        }
        result
    }

    fn serve_device(&self, stream: &mut TcpStream, index: usize) -> io::Result<()> {
        loop {
            let request = read_request(stream)?;
            let now = self.now();
            let mut state = self.lock();
            // What was due before the request happens before it.
            state.rig.advance(now);
            match request {
                Request::Unlink { seqnum, victim } => {
                    let gone = state.unlink(index, victim);
                    unlink_reply(stream, seqnum, if gone { ECONNRESET } else { 0 })?;
                }
                Request::Submit { seqnum, endpoint: 0, setup, length, .. } => {
                    match state.setup(index, &setup) {
                        Some(mut data) => {
                            data.truncate(length);
                            let actual = if setup[0] & 0x80 == 0 { length } else { data.len() };
                            submit_reply(stream, seqnum, 0, actual, &data)?;
                        }
                        None => submit_reply(stream, seqnum, EPIPE, 0, &[])?,
                    }
                }
                Request::Submit { seqnum, input: false, data, .. } => {
                    if state.rig.cameras[index].control_stalled() {
                        submit_reply(stream, seqnum, EPIPE, 0, &[])?;
                    } else {
                        submit_reply(stream, seqnum, 0, data.len(), &[])?;
                        state.rig.cameras[index].command(&data, now);
                    }
                }
                Request::Submit { seqnum, endpoint, length, .. } => {
                    if endpoint == u32::from(endpoints::STREAM_IN & 0xf) {
                        state.rig.cameras[index].stream.submit(seqnum, length);
                        state.ports[index].urbs.push(seqnum);
                    } else {
                        state.ports[index].acks.push_back(seqnum);
                    }
                }
            }
            state.step(now);
            drop(state);
            self.changed.notify_all();
        }
    }
}

impl State {
    /// Lets everything happen that is due, and answers the URBs that are finished by it.
    fn step(&mut self, now: u64) {
        self.rig.advance(now);
        for index in 0..self.ports.len() {
            if self.flush(index, now).is_err() || self.rig.cameras[index].take_unplug() {
                self.unplug(index);
            }
        }
    }

    fn flush(&mut self, index: usize, now: u64) -> io::Result<()> {
        let (camera, port) = (&mut self.rig.cameras[index], &mut self.ports[index]);
        let Some(connection) = &mut port.connection else { return Ok(()) };
        while let Some(seqnum) = port.acks.front().copied() {
            if camera.control_stalled() {
                submit_reply(connection, seqnum, EPIPE, 0, &[])?;
            } else if let Some(reply) = camera.reply(now) {
                submit_reply(connection, seqnum, 0, reply.len(), &reply)?;
            } else {
                break;
            }
            port.acks.pop_front();
        }
        for done in camera.stream.pump() {
            let status = match done.end {
                UrbEnd::Done => 0,
                UrbEnd::Stalled => EPIPE,
                UrbEnd::Overflow => EOVERFLOW,
            };
            port.urbs.retain(|urb| *urb != done.id);
            submit_reply(connection, done.id, status, done.data.len(), &done.data)?;
        }
        Ok(())
    }

    fn unlink(&mut self, index: usize, victim: u32) -> bool {
        let port = &mut self.ports[index];
        port.urbs.retain(|urb| *urb != victim);
        let waiting = port.acks.len();
        port.acks.retain(|urb| *urb != victim);
        port.acks.len() < waiting || self.rig.cameras[index].stream.unlink(victim).is_some()
    }

    /// The device's side of a pulled cable.
    fn unplug(&mut self, index: usize) {
        let port = &mut self.ports[index];
        if let Some(connection) = port.connection.take() {
            let _ = connection.shutdown(Shutdown::Both);
        }
        port.acks.clear();
        for urb in port.urbs.drain(..) {
            self.rig.cameras[index].stream.unlink(urb);
        }
    }

    /// A request on endpoint 0; `None` stalls it.
    fn setup(&mut self, index: usize, setup: &[u8; 8]) -> Option<Vec<u8>> {
        let [kind, request, value_low, value_high, index_low, ..] = *setup;
        let camera = &mut self.rig.cameras[index];
        let is_stream = index_low == endpoints::STREAM_IN;
        match (kind, request) {
            (0x80, 6) => self.ports[index].descriptors.get(value_high, value_low),
            (0x80, 8) => Some(vec![1]),
            (0x80 | 0x81, 0) => Some(vec![0, 0]),
            (0x82, 0) => Some(vec![u8::from(is_stream && camera.stream.is_halted()), 0]),
            (0x81, 10) => Some(vec![0]),
            (0x02, 3) if is_stream => {
                camera.stream.halt();
                Some(Vec::new())
            }
            (0x02, 1) if is_stream => {
                camera.clear_stream_halt();
                Some(Vec::new())
            }
            (0x02, 1) => {
                camera.clear_control_halt();
                Some(Vec::new())
            }
            // SET_CONFIGURATION, SET_INTERFACE, features, SET_SEL, SET_ISOCH_DELAY.
            (0x00..=0x02, 1 | 3 | 9 | 11 | 0x30 | 0x31) => Some(Vec::new()),
            _ => None,
        }
    }
}
