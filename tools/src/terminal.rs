//! A few lines at the bottom of the terminal that are drawn anew, under what has been said before.

use std::io::{self, IsTerminal, Write};

/// The live lines, on standard error. Where that is no terminal, they are left out.
#[derive(Debug)]
pub struct LiveLines {
    terminal: bool,
    drawn: usize,
}

impl LiveLines {
    /// Draws nothing yet; with `quiet` never.
    pub fn new(quiet: bool) -> Self {
        Self { terminal: !quiet && io::stderr().is_terminal(), drawn: 0 }
    }

    /// Whether anybody sees the lines.
    pub const fn is_seen(&self) -> bool {
        self.terminal
    }

    /// Replaces the lines.
    pub fn draw(&mut self, lines: &[String]) {
        if !self.terminal {
            return;
        }
        let shown = fitting(lines, size());
        write_all(&format!("{}{}", self.erase(), shown.concat()));
        self.drawn = shown.len();
    }

    /// Says a line that stays, above the live ones (which are gone until they are next drawn).
    pub fn say(&mut self, line: &str) {
        let erase = self.erase();
        self.drawn = 0;
        write_all(&format!("{erase}{line}\n"));
    }

    /// Moves to the first drawn line and clears from there.
    fn erase(&self) -> String {
        if self.drawn == 0 { String::new() } else { format!("\x1b[{}A\x1b[J", self.drawn) }
    }
}

/// What of `lines` fits a terminal of so many columns and rows: the way back up ends at its first row, and a line that
/// is wrapped has two.
fn fitting(lines: &[String], (columns, rows): (usize, usize)) -> Vec<String> {
    let cut = |line: &String| line.chars().take(columns).chain(['\n']).collect();
    lines.iter().take(rows.saturating_sub(1)).map(cut).collect()
}

/// Columns and rows of the terminal; where it does not tell, those of the oldest.
fn size() -> (usize, usize) {
    let told = terminal_size::terminal_size_of(io::stderr());
    told.map_or((80, 24), |(columns, rows)| (columns.0.into(), rows.0.into()))
}

fn write_all(text: &str) {
    // Nobody is left to tell when the terminal is gone.
    let _ = io::stderr().write_all(text.as_bytes());
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_drawn_can_be_taken_back_on_a_small_terminal() {
        let lines: Vec<String> = ["─│● wide", "b", "c", "d"].map(str::to_owned).into();
        assert_eq!(fitting(&lines, (3, 4)), ["─│●\n", "b\n", "c\n"]);
        assert_eq!(fitting(&lines, (80, 24)).concat(), "─│● wide\nb\nc\nd\n");
        assert!(fitting(&lines, (80, 0)).is_empty());
        let live = LiveLines { terminal: true, drawn: 3 };
        assert_eq!(live.erase(), "\x1b[3A\x1b[J");
    }
}
