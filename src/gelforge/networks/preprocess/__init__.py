"""What is done to a picture before a network sees it, numpy and OpenCV alone: the same in training and in use."""
