"""Files of models: the ONNX file that predicts, the safetensors file that training resumes or is fine-tuned from, their metadata."""
