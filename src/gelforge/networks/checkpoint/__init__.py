"""Files of models: the ONNX file that predicts, the safetensors file that a network is fine-tuned from, their metadata."""
