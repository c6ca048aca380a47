"""What the inputs of a log say of each other: images against no-contact images and poses, before anything is solved or learnt."""
