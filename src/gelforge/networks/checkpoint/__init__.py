"""Files of models: the ONNX file that predicts, the safetensors file that training goes on from, their metadata."""
