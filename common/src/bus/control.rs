use std::time::{Duration, Instant};

use iceoryx2::{
    port::{client::Client, server::Server},
    service::builder::request_response::{
        RequestResponseOpenError as Open, RequestResponseOpenOrCreateError as OpenOrCreate,
    },
};

use super::{
    Bus, BusError, Service,
    service::{MAX_NODES, Opening},
    topic::CONTROL,
};
use crate::{
    bus::Limits,
    wire::{ControlRequest, ControlResponse},
};

const LIMITS: Limits = Limits { writers: 1, readers: 16, queue: 4, borrowed: 2, loaned: 2 };

type Factory = iceoryx2::service::port_factory::request_response::PortFactory<
    Service,
    ControlRequest,
    (),
    ControlResponse,
    (),
>;

fn open(bus: &Bus) -> Result<(Factory, Opening), BusError> {
    let opening = Opening::new(CONTROL, &LIMITS, "capture");
    let factory = bus
        .node
        .service_builder(&opening.name()?)
        .request_response::<ControlRequest, ControlResponse>()
        .max_servers(LIMITS.writers)
        .max_clients(LIMITS.readers)
        .max_active_requests_per_client(LIMITS.queue)
        .max_response_buffer_size(LIMITS.queue)
        .max_nodes(MAX_NODES)
        .open_or_create_with_attributes(&bus.version_wanted())
        .map_err(|e| match e {
            OpenOrCreate::RequestResponseOpenError(
                Open::IncompatibleAttributes
                | Open::IncompatibleRequestOrResponseType
                | Open::DoesNotSupportRequestedAmountOfNodes
                | Open::VersionMismatch,
            ) => opening.wire_version(),
            OpenOrCreate::RequestResponseOpenError(Open::ExceedsMaxNumberOfNodes) => {
                opening.too_many("process", MAX_NODES)
            }
            other => opening.failed("opening it", other),
        })?;
    Ok((factory, opening))
}

/// Capture's end of `rig/control`.
#[derive(Debug)]
pub struct ControlServer {
    port: Server<Service, ControlRequest, (), ControlResponse, ()>,
    opening: Opening,
}

impl ControlServer {
    /// Opens the answering end.
    ///
    /// # Errors
    /// [`BusError::SecondWriter`] when another capture answers already; [`BusError::Service`].
    pub fn open(bus: &Bus) -> Result<Self, BusError> {
        let (factory, opening) = open(bus)?;
        let port = factory.server_builder().create().map_err(|e| match e {
            iceoryx2::service::port_factory::server::ServerCreateError::ExceedsMaxSupportedServers => {
                BusError::SecondWriter { service: CONTROL.into(), writer: "capture" }
            }
            other => opening.failed("opening its answering end", other),
        })?;
        Ok(Self { port, opening })
    }

    /// Answers every request that waits.
    ///
    /// # Errors
    /// [`BusError::Service`].
    pub fn answer(&self, mut handle: impl FnMut(&ControlRequest) -> ControlResponse) -> Result<(), BusError> {
        while let Some(request) =
            self.port.receive().map_err(|e| self.opening.failed("receiving a request", e))?
        {
            let response = handle(request.payload());
            // The client may have gone: then nobody misses the answer.
            let _ = request.send_copy(response);
        }
        Ok(())
    }
}

/// A tool's end of `rig/control`.
#[derive(Debug)]
pub struct ControlClient {
    port: Client<Service, ControlRequest, (), ControlResponse, ()>,
    opening: Opening,
}

impl ControlClient {
    /// Opens an asking end.
    ///
    /// # Errors
    /// [`BusError::Service`].
    pub fn open(bus: &Bus) -> Result<Self, BusError> {
        let (factory, opening) = open(bus)?;
        let port =
            factory.client_builder().create().map_err(|e| opening.failed("opening an asking end", e))?;
        Ok(Self { port, opening })
    }

    /// Asks, and waits at most `timeout` for the answer.
    ///
    /// # Errors
    /// [`BusError::NoAnswer`] and [`BusError::Service`].
    pub fn ask(&self, request: &ControlRequest, timeout: Duration) -> Result<ControlResponse, BusError> {
        let pending =
            self.port.send_copy(*request).map_err(|e| self.opening.failed("sending a request", e))?;
        let until = Instant::now() + timeout;
        loop {
            if let Some(response) =
                pending.receive().map_err(|e| self.opening.failed("receiving the answer", e))?
            {
                return Ok(*response.payload());
            }
            if Instant::now() > until {
                return Err(BusError::NoAnswer { service: CONTROL.into(), timeout_ms: timeout.as_millis() });
            }
            // Requests are rare and answered within a frame: an event service would be one more.
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}
