"""From a picture to a reading, on onnxruntime: the one way that predict, Reader, stream and live share."""
