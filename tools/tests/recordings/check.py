"""Reads a recording of netcord's with the packages of others: every message must be what its schema says."""
import csv
import importlib
import sys
from collections import Counter

import numpy as np
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

path, positions = sys.argv[1:]
counts, last = Counter(), {}
found = []
with open(path, "rb") as file:
    reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
    summary = reader.get_summary()
    for schema, channel, message in reader.iter_messages():
        counts[channel.topic] += 1
        if schema.name.startswith("foxglove."):
            name = schema.name.split(".")[1]
            module = importlib.import_module(f"foxglove_schemas_protobuf.{name}_pb2")
            decoded = getattr(module, name)()
            decoded.ParseFromString(message.data)
            # Nothing that the package's own schema does not know.
            decoded.DiscardUnknownFields()
            assert decoded.ByteSize() == len(message.data), (channel.topic, schema.name)
            last[channel.topic] = decoded
    # Ours, by the descriptions in the file itself.
    for schema, channel, message, decoded in reader.iter_decoded_messages(topics=["/ball/position"]):
        if decoded.reason == 0:
            found.append((decoded.stamps.mid_exposure_ns, *decoded.position_m))
    metadata = {m.name: m.metadata for m in reader.iter_metadata()}

assert summary.statistics.message_count == sum(counts.values()), (summary.statistics, counts)
for camera in ("left", "right"):
    for kind in ("image", "header", "calibration", "detections", "annotations"):
        assert counts[f"/camera/{camera}/{kind}"] > 0, (camera, kind)
    image = last[f"/camera/{camera}/image"]
    assert image.encoding == "bayer_rggb8" and len(image.data) == image.step * image.height
    calibration = last[f"/camera/{camera}/calibration"]
    k, p = np.reshape(calibration.K, (3, 3)), np.reshape(calibration.P, (3, 4))
    assert np.allclose(np.reshape(calibration.R, (3, 3)), np.eye(3))
    assert np.allclose(p, np.hstack([k, np.zeros((3, 1))])), "P = [K|0]"
    assert calibration.distortion_model == "plumb_bob" and len(calibration.D) == 5
assert counts["/ball/trajectory"] > 0 and counts["/scene/ball"] > 0 and counts["/scene/path"] > 0
assert last["/tf"].parent_frame_id == "table"
assert metadata["netcord"]["world_frame"] == "table"
with open(positions, newline="") as file:
    rows = [(int(r["t_ns"]), float(r["x"]), float(r["y"]), float(r["z"])) for r in csv.DictReader(file)]
assert rows and rows == found, "the table and the recording say the same"
