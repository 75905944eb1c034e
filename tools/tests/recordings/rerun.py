"""Opens a recording of netcord's with Rerun: it finds no fault, and takes pictures, cameras and poses for its own."""
import subprocess
import sys

(path,) = sys.argv[1:]


def rerun(*arguments):
    out = subprocess.run([sys.executable, "-m", "rerun", *arguments], capture_output=True, text=True, check=False)
    assert out.returncode == 0, (arguments, out.stdout, out.stderr)
    return out.stdout


verdicts = [line.split() for line in rerun("mcap", "check", path).splitlines()]
channels = {words[3]: words[0] for words in verdicts if len(words) > 3 and words[3].startswith("/")}
assert channels and set(channels.values()) == {"ok"}, channels
rerun("mcap", "convert", path, "-o", "out.rrd")
chunks = [line for line in rerun("rrd", "print", "out.rrd").splitlines() if line.startswith("Chunk(")]
for topic, column in [
    ("/camera/left/image", "Image:buffer"),
    ("/camera/right/image", "Image:buffer"),
    ("/camera/left/calibration", "Pinhole:image_from_camera"),
    ("/tf", "Transform3D:translation"),
    ("/scene/table", "foxglove.SceneUpdate:message"),
    ("/scene/ball", "foxglove.SceneUpdate:message"),
    ("/scene/path", "foxglove.SceneUpdate:message"),
    ("/ball/trajectory", "netcord.BallTrajectory:message"),
]:
    assert any(f" - {topic} - " in chunk and column in chunk for chunk in chunks), (topic, column)
