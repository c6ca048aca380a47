"""How walkers move: at first by each other's differences, then also by what their own past looks like."""

import numpy as np

# Degrees of freedom of the fitted proposal: tails heavier than the posterior's, so that no walker stays in one.
TAIL = 5.0
INDEPENDENT = 0.5  # fraction of the steps that take it


def learning_moves() -> list:
    """Moves that know nothing of the posterior's shape: emcee's ensemble moves, with weights."""
    from emcee import moves

    return [(moves.StretchMove(), 0.3), (moves.DEMove(), 0.6), (moves.DESnookerMove(), 0.1)]


def learnt_moves(past: np.ndarray) -> list:
    """Half the steps jump to independent draws of Student's t fitted to `past`, (steps, walkers, k); with weights.

    Such a step forgets where the walker was. The past is fixed, so this is plain Metropolis-Hastings (Tierney
    1994, Annals of Statistics 22:1701, section 2.3.3); the other half moves as the ensemble does and reaches what
    the fit does not cover.
    """
    from emcee import moves

    rest = 1.0 - INDEPENDENT
    return [
        (moves.MHMove(independent_draws(past)), INDEPENDENT),
        (moves.StretchMove(), 0.2 * rest),
        (moves.DEMove(), 0.8 * rest),
    ]


def independent_draws(past: np.ndarray):
    """Proposal for emcee's MHMove: draws of the fitted t and log q(old) - log q(new)."""
    flat = past.reshape(-1, past.shape[-1])
    size = flat.shape[1]
    centre = flat.mean(axis=0)
    root = np.linalg.cholesky(np.atleast_2d(np.cov(flat, rowvar=False)) + 1e-12 * np.diag(flat.var(axis=0)))
    unroot = np.linalg.inv(root)

    def log_density(x):
        z = (x - centre) @ unroot.T
        return -0.5 * (TAIL + size) * np.log1p((z * z).sum(axis=1) / TAIL)

    def propose(coordinates, random):
        z = random.standard_normal(coordinates.shape)
        mixing = random.chisquare(TAIL, len(coordinates)) / TAIL
        new = centre + (z / np.sqrt(mixing)[:, None]) @ root.T
        return new, log_density(coordinates) - log_density(new)

    return propose
