"""Datasets of stage 60 as networks learn from them: arrays, splits, subsets, batches, augmentation."""
