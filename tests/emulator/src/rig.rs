use crate::{Camera, Edge};

/// A wire from an output line of one camera to an input line of another.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Wire {
    /// Camera and line that drive it.
    pub from: (usize, u32),
    /// Camera and line that it drives.
    pub to: (usize, u32),
}

/// Cameras and the wires between them.
#[derive(Debug, Default)]
pub struct Rig {
    /// The cameras.
    pub cameras: Vec<Camera>,
    /// The wires.
    pub wires: Vec<Wire>,
}

impl Rig {
    /// The instant of the next event of any camera.
    pub fn next_event(&self) -> Option<u64> {
        self.cameras.iter().filter_map(Camera::next_event).min()
    }

    /// Lets everything happen that is due at `now`, in the order of time, edges included.
    pub fn advance(&mut self, now: u64) {
        loop {
            let next =
                self.cameras.iter().filter_map(Camera::next_exposure_event).min().filter(|due| *due <= now);
            let mut edges: Vec<(usize, Edge)> = Vec::new();
            for (index, camera) in self.cameras.iter_mut().enumerate() {
                let until = next.unwrap_or(now);
                edges.extend(camera.advance(until).into_iter().map(|edge| (index, edge)));
            }
            let wired: Vec<(usize, Edge)> = edges
                .into_iter()
                .flat_map(|(index, edge)| {
                    self.wires
                        .iter()
                        .filter(move |wire| wire.from == (index, edge.line))
                        .map(move |wire| (wire.to.0, Edge { line: wire.to.1, ..edge }))
                })
                .collect();
            let quiet = wired.is_empty();
            for (index, edge) in wired {
                self.cameras[index].input_edge(edge);
            }
            // Replies that are due stay until they are fetched: they are no reason to go on.
            let more = self.cameras.iter().any(|c| c.next_exposure_event().is_some_and(|due| due <= now));
            if quiet && !more {
                return;
            }
        }
    }
}
