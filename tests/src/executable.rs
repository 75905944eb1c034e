use std::{
    env,
    path::{Path, PathBuf},
    process::Command,
    sync::OnceLock,
};

/// The `netcord` executable of this tree, built on the first call with the profile and in the target folder of
/// the test that asks. Cargo decides what is out of date, so it is never a stale one.
///
/// # Panics
/// When it cannot be built.
pub fn executable() -> &'static Path {
    static BUILT: OnceLock<PathBuf> = OnceLock::new();
    BUILT.get_or_init(build)
}

fn build() -> PathBuf {
    // …/target/<profile>/deps/<this test>
    let test = env::current_exe().expect("the test knows itself");
    let profile = test.ancestors().nth(2).expect("cargo puts tests into <profile>/deps");
    let target = profile.parent().expect("a profile's folder lies in the target folder");
    let profile_name = match profile.file_name().and_then(|n| n.to_str()) {
        Some("debug") => "dev",
        Some(name) => name,
        None => panic!("no profile in {}", test.display()),
    };
    let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("tests/ lies in the workspace");
    let cargo = env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let status = Command::new(cargo)
        .args(["build", "--quiet", "--workspace", "--bin", "netcord", "--profile", profile_name])
        .arg("--manifest-path")
        .arg(workspace.join("Cargo.toml"))
        .arg("--target-dir")
        .arg(target)
        .status()
        .expect("cargo runs");
    assert!(status.success(), "netcord does not build");
    profile.join("netcord")
}
