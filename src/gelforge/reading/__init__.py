"""From an image to forces: frame, light, markers, faults, intervals, profiles; numpy, OpenCV and onnxruntime alone."""
