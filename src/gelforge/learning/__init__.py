"""From datasets to networks: data, augmentation, training, evaluation. Only nets, train, augment, recipe, export need torch."""
