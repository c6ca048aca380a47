"""Names of the splits of a dataset: FEATS' own, and those of what training never saw."""

TRAINING, VALIDATION, TEST = "train", "val", "test"
UNSEEN_INDENTER, UNSEEN_SENSOR, UNSEEN_BOTH = "test_unseen_indenter", "test_unseen_sensor", "test_unseen_both"
SPLITS = (TRAINING, VALIDATION, TEST, UNSEEN_INDENTER, UNSEEN_SENSOR, UNSEEN_BOTH)
