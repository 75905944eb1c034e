use std::{collections::BTreeMap, fs, time::Instant};

/// Processor time that processes have used, from /proc.
#[derive(Debug)]
pub(super) struct CpuUse {
    at: Instant,
    seconds: BTreeMap<String, (u32, f64)>,
}

impl CpuUse {
    /// Looks now at `processes`, given as name and process id.
    pub(super) fn now(processes: &BTreeMap<String, u32>) -> Self {
        let seconds = processes
            .iter()
            .filter_map(|(name, pid)| Some((name.clone(), (*pid, cpu_seconds(*pid)?))))
            .collect();
        Self { at: Instant::now(), seconds }
    }

    /// The share of one processor that each process has used since `earlier`; one that was restarted is
    /// left out.
    pub(super) fn share_since(&self, earlier: &Self) -> BTreeMap<String, f64> {
        let wall = self.at.duration_since(earlier.at).as_secs_f64();
        self.seconds
            .iter()
            .filter_map(|(name, (pid, now))| {
                let (_, before) = earlier.seconds.get(name).filter(|(p, _)| p == pid)?;
                Some((name.clone(), (now - before) / wall))
            })
            .collect()
    }
}

/// User and system time of a process in seconds: fields 14 and 15 of /proc/<pid>/stat, proc(5).
fn cpu_seconds(pid: u32) -> Option<f64> {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    // The name in field 2 may hold blanks; the closing bracket ends it.
    let mut fields = stat.rsplit_once(')')?.1.split_whitespace().skip(11);
    let ticks = fields.next()?.parse::<f64>().ok()? + fields.next()?.parse::<f64>().ok()?;
    let per_second = nix::unistd::sysconf(nix::unistd::SysconfVar::CLK_TCK).ok()??;
    Some(ticks / per_second as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn work_shows_and_sleep_does_not() {
        let me = BTreeMap::from([("me".to_owned(), std::process::id())]);
        let before = CpuUse::now(&me);
        let start = Instant::now();
        while start.elapsed().as_millis() < 100 {
            std::hint::spin_loop();
        }
        let share = CpuUse::now(&me).share_since(&before)["me"];
        assert!(share > 0.0 && share < 64.0, "{share}");
    }
}
