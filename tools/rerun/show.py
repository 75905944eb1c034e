"""Opens a recording of netcord's in Rerun, with what Rerun does not draw by itself of Foxglove's schemas: table,
ball and predicted path.

    pip install rerun-sdk mcap mcap-protobuf-support
    python tools/rerun/show.py RECORDING.mcap              the viewer opens
    python tools/rerun/show.py RECORDING.mcap OUT.rrd      a file for it
"""
import sys

import rerun as rr
import rerun.blueprint as rrb
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

X, Y, NET_X, NET_Z = 0.7625, 1.37, 0.915, 0.1525  # half the table's size and the net's, m
PATH = (40, 140, 255)
TRAIL_NS = 600_000_000


def in_table_frame(entity):
    rr.log(entity, rr.CoordinateFrame("table"), static=True)
    return entity


def main(recording, out=None):
    rr.init("netcord", spawn=out is None)
    cameras, found, paths = set(), [], []
    with open(recording, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        topics = [channel.topic for channel in reader.get_summary().channels.values()]
        cameras = sorted(topic.split("/")[2] for topic in topics if topic.endswith("/image"))
        results = reader.iter_decoded_messages(topics=["/ball/position", "/ball/trajectory"])
        for _, channel, message, decoded in results:
            if channel.topic == "/ball/position" and decoded.reason == 0:
                found.append((message.log_time, list(decoded.position_m)))
            elif channel.topic == "/ball/trajectory" and decoded.outcome == 0:
                points = [list(decoded.position_m)] + [list(p.position_m) for p in decoded.path]
                paths.append((message.log_time, points, [p.confidence for p in decoded.path]))
    views = [rrb.Spatial2DView(origin=f"/camera/{c}/image", name=c) for c in cameras]
    table = rrb.SpatialInformation(target_frame="table")
    scene = rrb.Spatial3DView(origin="/", name="scene", spatial_information=table)
    blueprint = rrb.Blueprint(rrb.Horizontal(scene, rrb.Vertical(*views)), collapse_panels=True)
    if out is not None:
        rr.save(out, default_blueprint=blueprint)
    else:
        rr.send_blueprint(blueprint)
    rr.log_file_from_path(recording)
    lines = [
        [(-X, -Y, 0), (X, -Y, 0), (X, Y, 0), (-X, Y, 0), (-X, -Y, 0)],
        [(0, -Y, 0), (0, Y, 0)],
    ]
    net = [(-NET_X, 0, 0), (NET_X, 0, 0), (NET_X, 0, NET_Z), (-NET_X, 0, NET_Z), (-NET_X, 0, 0)]
    rr.log(in_table_frame("scene_3d/table"), rr.LineStrips3D([*lines, net], colors=[(200, 200, 200)]), static=True)
    ball, past, path = (in_table_frame(f"scene_3d/{name}") for name in ("ball", "past", "path"))
    for n, (t_ns, place) in enumerate(found):
        rr.set_time("message_log_time", timestamp=t_ns * 1e-9)
        rr.log(ball, rr.Points3D([place], radii=0.02, colors=[(255, 130, 20)]))
        recent = [p for t, p in found[:n] if t_ns - t < TRAIL_NS]
        rr.log(past, rr.Points3D(recent, radii=0.008, colors=[(255, 190, 120)]))
    for t_ns, points, sure in paths:
        rr.set_time("message_log_time", timestamp=t_ns * 1e-9)
        pieces = [points[i : i + 2] for i in range(len(points) - 1)]
        rr.log(path, rr.LineStrips3D(pieces, colors=[(*PATH, int(40 + 215 * s)) for s in sure], radii=0.006))


if len(sys.argv) not in (2, 3):
    sys.exit(__doc__)
main(*sys.argv[1:])
