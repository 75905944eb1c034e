"""Times OpenCV's mono calibration of a corner file, for the comparison in speed.rs: python3 opencv.py FILE.json RUNS"""
import json
import sys
import time

import cv2
import numpy

camera = next(iter(json.load(open(sys.argv[1]))["cameras"].values()))
objects = [numpy.array(v["object"], numpy.float32) for v in camera["views"].values()]
images = [numpy.array(v["image"], numpy.float32).reshape(-1, 1, 2) for v in camera["views"].values()]
times = []
for _ in range(int(sys.argv[2])):
    begin = time.perf_counter()
    rms = cv2.calibrateCamera(objects, images, tuple(camera["size"]), None, None)[0]
    times.append(1e3 * (time.perf_counter() - begin))
times.sort()
print(f"{times[0]} {times[len(times) // 2]} {rms} {cv2.__version__}")
