//! The bus as its users see it, in one process with several memberships; real processes are in the
//! crate `netcord-tests`.

use std::time::Duration;

use super::*;
use crate::{
    name::{CameraName, DomainName},
    wire::{BallPosition, ControlRequest, ControlResponse, FrameHeader, SearchWindow},
};

/// A domain that no other test uses, and that leaves nothing.
struct OwnDomain(DomainName);

impl OwnDomain {
    fn new(test: &str) -> Self {
        let domain = DomainName::new(format!("t{}-{test}", std::process::id())).expect("valid");
        Self(domain)
    }

    fn join(&self, process: &str) -> Bus {
        Bus::join(&self.0, process).expect("joined")
    }
}

impl Drop for OwnDomain {
    fn drop(&mut self) {
        DomainRemains::of(&self.0).remove().expect("removed");
        assert!(DomainRemains::of(&self.0).files().is_empty());
    }
}

const SOON: Duration = Duration::from_secs(5);

#[test]
fn messages_arrive_in_order_and_a_full_queue_drops_the_oldest() {
    let domain = OwnDomain::new("order");
    let (writer, reader) = (domain.join("triangulate"), domain.join("predict"));
    let topic = Topic::position();
    let publisher = writer.publisher(&topic).expect("first writer");
    let subscriber = reader.subscriber(&topic).expect("a place");
    let queue = topic.limits().queue as u64;
    for trigger_id in 1..=queue + 5 {
        publisher.send(&BallPosition { trigger_id, ..BallPosition::default() }).expect("sent");
    }
    let mut gaps = SequenceGaps::new();
    gaps.see(1, 0);
    let mut seen = Vec::new();
    while let Some(position) = subscriber.receive().expect("received") {
        seen.push(position.trigger_id);
    }
    assert_eq!(seen, (6..=queue + 5).collect::<Vec<_>>(), "the newest win");
}

#[test]
fn of_windows_only_the_newest_waits() {
    let domain = OwnDomain::new("newest");
    let (writer, reader) = (domain.join("predict"), domain.join("segment"));
    let topic = Topic::window(&CameraName::new("left").expect("valid"));
    let publisher = writer.publisher(&topic).expect("first writer");
    let subscriber = reader.subscriber(&topic).expect("a place");
    for made_from_trigger in 1..=3 {
        publisher.send(&SearchWindow { made_from_trigger, ..SearchWindow::default() }).expect("sent");
    }
    let newest = subscriber.receive().expect("received").expect("one waits");
    assert_eq!(newest.made_from_trigger, 3);
    assert!(subscriber.receive().expect("received").is_none());
}

#[test]
fn a_frame_is_read_where_it_was_written() {
    let domain = OwnDomain::new("frames");
    let (writer, reader) = (domain.join("capture"), domain.join("segment"));
    let topic = Topic::frames(&CameraName::new("left").expect("valid"));
    let publisher = FramePublisher::open(&writer, &topic, 6000).expect("first writer");
    let subscriber = FrameSubscriber::open(&reader, &topic, 2).expect("a place");

    let error = publisher.loan(6001).expect_err("too large");
    assert!(matches!(error, BusError::FrameTooLarge { bytes: 6001, slot: 6000, .. }), "{error}");

    for sequence in 1..=3 {
        let mut slot = publisher.loan(6000).expect("a free slot");
        slot.bytes_mut().fill(sequence as u8);
        slot.header_mut().sequence = sequence;
        publisher.publish(slot).expect("published");
    }
    wait_any(&[&subscriber as &dyn Listen], SOON).expect("woken");
    let mut gaps = SequenceGaps::new();
    let mut frames = Vec::new();
    while let Some(frame) = subscriber.receive().expect("received") {
        gaps.see_frame(frame.header());
        assert!(frame.bytes().iter().all(|b| u64::from(*b) == frame.header().sequence));
        frames.push(frame);
    }
    let sequences = frames.iter().map(|f| f.header().sequence).collect::<Vec<_>>();
    assert_eq!(sequences, [2, 3], "a queue of two keeps the newest two");
}

#[test]
fn a_reader_who_holds_its_fill_does_not_starve_the_writer() {
    let domain = OwnDomain::new("starve");
    let (writer, reader) = (domain.join("capture"), domain.join("record"));
    let topic = Topic::frames(&CameraName::new("left").expect("valid"));
    let publisher = FramePublisher::open(&writer, &topic, 100).expect("first writer");
    let greedy = FrameSubscriber::open(&reader, &topic, 99).expect("a place");
    let mut held = Vec::new();
    for _ in 0..500 {
        let slot = publisher.loan(100).expect("never starved");
        publisher.publish(slot).expect("published");
        if held.len() < topic.limits().borrowed {
            held.extend(greedy.receive().expect("received"));
        }
    }
    assert_eq!(held.len(), topic.limits().borrowed);
}

#[test]
fn a_second_writer_is_refused_and_the_first_lives_on() {
    let domain = OwnDomain::new("second");
    let (first, second) = (domain.join("capture"), domain.join("capture"));
    let topic = Topic::frames(&CameraName::new("left").expect("valid"));
    let publisher = FramePublisher::open(&first, &topic, 100).expect("first writer");
    let error = FramePublisher::open(&second, &topic, 100).expect_err("second writer");
    assert!(matches!(error, BusError::SecondWriter { writer: "capture", .. }), "{error}");
    publisher.publish(publisher.loan(100).expect("a slot")).expect("still works");
    drop(publisher);
    FramePublisher::open(&second, &topic, 100).expect("the place is free again");
}

#[test]
fn peers_of_another_wire_version_are_told_so() {
    let domain = OwnDomain::new("wire");
    let (old, new) = (domain.join("capture"), domain.join("segment"));
    // What a netcord of version 0 would have created: the same service with other attributes.
    let name = "rig/frameset".try_into().expect("valid");
    let _service =
        old.node.service_builder(&name).publish_subscribe::<FrameHeader>().open_or_create().expect("created");
    let error = new.subscriber(&Topic::frameset()).expect_err("another version");
    assert!(matches!(error, BusError::WireVersion { .. }), "{error}");
    assert!(error.to_string().contains("wire version"), "{error}");

    let other =
        Bus::join_with_wire_version(&domain.0, "capture", crate::wire::WIRE_VERSION + 1).expect("joined");
    let _server = ControlServer::open(&other).expect("the first to answer");
    let error = ControlClient::open(&new).expect_err("another version");
    assert!(matches!(error, BusError::WireVersion { .. }), "{error}");
}

#[test]
fn requests_are_answered_and_silence_is_an_error() {
    let domain = OwnDomain::new("control");
    let (capture, tool) = (domain.join("capture"), domain.join("tool"));
    let client = ControlClient::open(&tool).expect("a place");
    let request = ControlRequest { command: 6, ..ControlRequest::default() };
    let error = client.ask(&request, Duration::from_millis(20)).expect_err("nobody answers");
    assert!(error.to_string().contains("netcord capture"), "{error}");

    let server = ControlServer::open(&capture).expect("first");
    let answering = std::thread::spawn(move || {
        let until = std::time::Instant::now() + SOON;
        let mut answered = 0;
        while answered == 0 && std::time::Instant::now() < until {
            server
                .answer(|request| {
                    answered += 1;
                    ControlResponse {
                        trigger_id: u64::from(request.command) * 7,
                        ..ControlResponse::default()
                    }
                })
                .expect("answered");
        }
    });
    let response = client.ask(&request, SOON).expect("answered");
    answering.join().expect("ended");
    assert_eq!(response.trigger_id, 42);
}

#[test]
fn a_wait_ends_at_its_time_and_a_message_ends_it_early() {
    let domain = OwnDomain::new("wait");
    let (writer, reader) = (domain.join("capture"), domain.join("view"));
    let left = reader.subscriber(&Topic::position()).expect("a place");
    let right = reader.subscriber(&Topic::frameset()).expect("a place");
    let both: [&dyn Listen; 2] = [&left, &right];
    wait_any(&both, Duration::from_millis(1)).expect("nothing came");
    assert!(!left.has_message() && !right.has_message());
    let publisher = writer.publisher(&Topic::frameset()).expect("first writer");
    let sender = std::thread::spawn(move || {
        publisher.send(&crate::wire::Frameset::default()).expect("sent");
        publisher
    });
    while !right.has_message() {
        wait_any(&both, SOON).expect("woken");
    }
    assert!(right.receive().expect("received").is_some());
    drop(sender.join().expect("ended"));
}
