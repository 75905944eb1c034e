//! `netcord view`: a running rig in Foxglove or Lichtblick, over WebSocket.

mod preview;
mod show;

use std::path::PathBuf;

use foxglove::WebSocketServer;
use netcord_common::{DomainName, realtime};

use self::{preview::PreviewOptions, show::Show};
use super::RigArgs;
use crate::{exit::CommandResult, stage};

/// Serves a running rig to viewers: small pictures of each camera with boxes and search windows, the 3D scene
/// with the predicted path, latencies and losses. Open ws://HOST:PORT in Foxglove or Lichtblick (newer than 1.21:
/// the server speaks foxglove.sdk.v1, which older viewers do not); a layout for them lies in
/// tools/foxglove/netcord.json. Costs the pipeline nothing: it reads in what time the stages leave, and makes
/// pictures only for viewers that look at them.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The rig file.
    #[arg(required_unless_present = "rig_option")]
    rig: Option<PathBuf>,

    /// The rig file, as every other stage is told it.
    #[arg(long = "rig", value_name = "RIG.toml", conflicts_with = "rig")]
    rig_option: Option<PathBuf>,

    /// The domain in which the rig's processes meet; default: the rig's name.
    #[arg(long, env = "NETCORD_DOMAIN", value_name = "NAME")]
    domain: Option<DomainName>,

    /// The address on which viewers are served; 0.0.0.0 for all of this machine's.
    #[arg(long, value_name = "HOST", default_value = "127.0.0.1")]
    host: String,

    /// The port on which viewers are served; 0 for any that is free.
    #[arg(long, value_name = "PORT", default_value_t = 8765)]
    port: u16,

    /// Pictures a second of each camera, at most.
    #[arg(long, value_name = "HZ", default_value_t = 10.0)]
    preview_rate: f64,

    /// Width of the pictures in pixels, at most.
    #[arg(long, value_name = "PX", default_value_t = 640)]
    preview_width: u32,
}

/// Stages come first.
const NICENESS: i32 = 10;

/// Runs `netcord view`.
pub fn run(args: &Args) -> CommandResult {
    if !(args.preview_rate.is_finite() && args.preview_rate > 0.0) {
        return Err(format!("--preview-rate is {}; it must be above zero", args.preview_rate).into());
    }
    let rig = args.rig.clone().or_else(|| args.rig_option.clone()).ok_or("no rig: give its file")?;
    let rig_args = RigArgs { rig, domain: args.domain.clone() };
    let options = PreviewOptions { rate_hz: args.preview_rate, width: args.preview_width.max(16) };
    stage::run("view", &rig_args, |stage| {
        // Before the server starts its threads, so that they inherit it.
        if let Err(e) = realtime::step_back(NICENESS) {
            tracing::debug!("viewing runs at ordinary priority: {e}");
        }
        let server = WebSocketServer::new()
            .name(format!("netcord {}", stage.rig.name))
            .bind(&args.host, args.port)
            .start_blocking()
            .map_err(|e| format!("cannot serve viewers on {}:{}: {e}", args.host, args.port))?;
        println!("ws://{}:{}", args.host, server.port());
        let result = Show::attach(stage, options).and_then(|mut show| show.run(stage));
        server.stop().wait_blocking();
        result.map_err(Box::<dyn std::error::Error>::from)
    })
}

#[cfg(test)]
mod tests {
    use serde_json::Value;

    const LAYOUT: &str = include_str!("../../../foxglove/netcord.json");

    /// All texts of a JSON value, keys included.
    fn texts(value: &Value, into: &mut Vec<String>) {
        match value {
            Value::String(text) => into.push(text.clone()),
            Value::Array(items) => items.iter().for_each(|item| texts(item, into)),
            Value::Object(members) => members.iter().for_each(|(key, member)| {
                into.push(key.clone());
                texts(member, into);
            }),
            _ => {}
        }
    }

    /// The panels that a layout's tree shows.
    fn panels(node: &Value, into: &mut Vec<String>) {
        match node {
            Value::String(panel) => into.push(panel.clone()),
            _ => ["first", "second"].iter().for_each(|side| panels(&node[*side], into)),
        }
    }

    #[test]
    fn the_layout_shows_what_is_served() {
        let layout: Value = serde_json::from_str(LAYOUT).expect("JSON");
        let mut shown = Vec::new();
        panels(&layout["layout"], &mut shown);
        shown.sort();
        let mut configured: Vec<_> =
            layout["configById"].as_object().expect("panels").keys().cloned().collect();
        configured.sort();
        assert_eq!(shown, configured, "each panel is configured and shown");

        let mut all = Vec::new();
        texts(&layout, &mut all);
        // The cameras of the example rig of two.
        let camera = |topic: &str| {
            let (name, kind) = topic.strip_prefix("/camera/")?.split_once('/')?;
            Some(["left", "right"].contains(&name) && ["image", "calibration", "annotations"].contains(&kind))
        };
        for topic in all.iter().filter(|text| text.starts_with('/')) {
            let is_served = topic.starts_with("/scene/")
                || topic.starts_with("/statistics.")
                || camera(topic) == Some(true);
            assert!(is_served, "{topic} is not served");
        }
    }
}
