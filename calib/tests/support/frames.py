"""Decodes a video into grey pictures: python3 frames.py VIDEO FOLDER [EVERY]. For tests: needs OpenCV."""
import sys

import cv2

video, folder = cv2.VideoCapture(sys.argv[1]), sys.argv[2]
count = 0
while True:
    there, frame = video.read()
    if not there:
        break
    cv2.imwrite(f"{folder}/{count:04d}.png", cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY), [cv2.IMWRITE_PNG_COMPRESSION, 1])
    count += 1
print(count)
