"""Ensemble sampling that is lengthened until long enough, resumed after a kill, and judged."""

import hashlib
import json
from dataclasses import dataclass

import numpy as np

from gelforge.calibration.moves import learning_moves, learnt_moves
from gelforge.errors import BadInput, GelforgeError
from gelforge.flow.files import publish
from gelforge.records.npz import DAMAGED

LEARN = 600  # first steps, whose second half the later moves are fitted to; never kept
CHUNK = 800  # steps between checks and checkpoints, at least; a third of the chain once that is more
MOVES = 2  # raise when the moves change: a chain on disk made by older ones is then not gone on with


class NotConverged(GelforgeError):
    """A chain that cannot be trusted; the message holds the figures and the hint."""


@dataclass(frozen=True)
class Rules:
    """When a chain is long enough, and when to give up.

    walkers: even, at least twice the parameters. taus: autocorrelation times kept after the burn-in.
    acceptance: allowed range. rhat: largest split R-hat. max_steps: bound on the length.
    """

    walkers: int
    seed: int
    taus: float
    acceptance: tuple
    rhat: float
    max_steps: int


@dataclass(frozen=True)
class Figures:
    """What a chain is judged by; tau and rhat are the worst over the parameters."""

    steps: int
    burn: int
    tau: float
    taus: float
    acceptance: float
    rhat: float

    def meets(self, rules: Rules) -> bool:
        low, high = rules.acceptance
        return self.taus >= rules.taus and self.rhat < rules.rhat and low <= self.acceptance <= high


@dataclass(frozen=True)
class Chain:
    """coordinates: (steps, walkers, free) after the burn-in; log_probability: (steps, walkers)."""

    coordinates: np.ndarray
    log_probability: np.ndarray
    figures: Figures

    def flat(self, size: int | None = None) -> np.ndarray:
        """Draws (size, free), evenly spaced over the chain; all of them where size is None."""
        flat = self.coordinates.reshape(-1, self.coordinates.shape[-1])
        return flat if size is None or size >= len(flat) else flat[np.linspace(0, len(flat) - 1, size).astype(int)]


def split_rhat(chains: np.ndarray) -> np.ndarray:
    """Split R-hat of every parameter, walkers as chains, each cut in two halves.

    chains: (steps, walkers, k). Gelman et al., Bayesian Data Analysis, 3rd ed., section 11.4.
    """
    half = len(chains) // 2
    halves = np.concatenate([chains[:half], chains[half : 2 * half]], axis=1)
    within = halves.var(axis=0, ddof=1).mean(axis=0)
    between = half * halves.mean(axis=0).var(axis=0, ddof=1)
    return np.sqrt((half - 1) / half + between / half / np.where(within > 0, within, np.nan))


def judge(coordinates: np.ndarray, accepted: float) -> Figures:
    """Figures of a whole chain (steps, walkers, k); at least ten autocorrelation times are burn-in.

    No figures can be given of the steps that moves are learnt from: none of these is kept.
    """
    import emcee

    steps = len(coordinates)
    if steps <= LEARN:
        return Figures(steps, steps, steps, 0.0, accepted, np.inf)
    tau = float(np.max(emcee.autocorr.integrated_time(coordinates[max(steps // 5, LEARN) :], tol=0)))
    if not np.isfinite(tau):
        return Figures(steps, steps // 2, steps, 0.0, accepted, np.inf)
    burn = max(min(int(10 * tau), steps // 2), LEARN)
    kept = coordinates[burn:]
    rhat = split_rhat(kept)
    worst = float(np.max(rhat)) if np.isfinite(rhat).all() else np.inf
    return Figures(steps, burn, tau, len(kept) / tau, accepted, worst)


def fingerprint(*parts) -> str:
    """Hash of arrays and plain values, to check whether a chain on disk is of this very problem."""
    digest = hashlib.sha256()
    for part in parts:
        if isinstance(part, np.ndarray):
            digest.update(np.ascontiguousarray(part).tobytes())
        else:
            digest.update(json.dumps(part, sort_keys=True, default=str).encode())
    return digest.hexdigest()


def problem_of(posterior, rules: Rules) -> str:
    """Fingerprint of everything a chain depends on but its length."""
    return fingerprint(*posterior.identity, [rules.walkers, rules.seed, MOVES])


def start_points(posterior, rules: Rules, rng: np.random.Generator) -> np.ndarray:
    """Walkers' first coordinates: the most probable of many draws from the priors, each once.

    Drawing from the prior, not from a ball around one optimum, lets a second mode be found. The first steps, which are
    never kept, spread them as the posterior is.
    """
    draws = posterior.model.draw(rng, 200 * rules.walkers)
    score = posterior(draws)
    finite = np.isfinite(score)
    if finite.sum() < rules.walkers:
        raise BadInput(
            f"only {finite.sum()} of {len(draws)} draws from the priors have a finite probability under model "
            f"{posterior.model.name}; check the priors in [calibrate.priors] and the units of the log"
        )
    return draws[np.argsort(-np.where(finite, score, -np.inf))[: rules.walkers]]


def save_checkpoint(path, problem: str, coordinates, log_probability, accepted, state) -> None:
    """Write the whole chain and the generator's state, whole or not at all."""
    _, keys, position, has_gauss, gauss = state
    with publish(path) as part:
        np.savez(
            part, problem=problem, coordinates=coordinates, log_probability=log_probability, accepted=accepted,
            rng_keys=keys, rng_rest=np.array([position, has_gauss, gauss], float),
        )  # fmt: skip


def load_checkpoint(path, problem: str):
    """Read what `save_checkpoint` wrote; None where absent, corrupt, or of another problem."""
    try:
        with np.load(path, allow_pickle=False) as file:
            if str(file["problem"]) != problem:
                return None
            position, has_gauss, gauss = file["rng_rest"]
            state = ("MT19937", file["rng_keys"], int(position), int(has_gauss), float(gauss))
            return file["coordinates"], file["log_probability"], file["accepted"], state
    except DAMAGED:
        return None


def sample(posterior, rules: Rules, path=None, say=None) -> Chain:
    """Sample until the rules are met; raise NotConverged with the figures where they cannot be.

    The chain is kept at `path` at every check and continues there; an interrupted and
    resumed chain is the same, to the last digit, as an uninterrupted one. say(figures) reports.
    """
    import emcee

    size = len(posterior.model.free)
    if rules.walkers < 2 * size or rules.walkers % 2:
        raise BadInput(f"[calibrate] walkers is {rules.walkers}; {size} parameters need an even number >= {2 * size}")
    problem = problem_of(posterior, rules)
    rng = np.random.default_rng(rules.seed)
    kept = load_checkpoint(path, problem) if path else None
    if kept:
        chain, score, accepted, random_state = kept
        state = emcee.State(chain[-1], log_prob=score[-1], random_state=random_state)
    else:
        chain, score = np.empty((0, rules.walkers, size)), np.empty((0, rules.walkers))
        accepted = np.zeros(rules.walkers)
        seeded = np.random.RandomState(rng.integers(2**32)).get_state()
        state = emcee.State(start_points(posterior, rules, rng), random_state=seeded)
    figures = judge(chain, float(accepted.mean() / len(chain))) if len(chain) else None
    while figures is None or not figures.meets(rules):
        if figures is not None and len(chain) >= rules.max_steps:
            raise NotConverged(complaint(posterior.model, chain, figures, rules))
        learning = len(chain) < LEARN
        moves = learning_moves() if learning else learnt_moves(chain[LEARN // 2 : LEARN])
        sampler = emcee.EnsembleSampler(rules.walkers, size, posterior, vectorize=True, moves=moves)
        ahead = LEARN - len(chain) if learning else max(CHUNK, len(chain) // 3)
        ahead = min(ahead, rules.max_steps - len(chain))
        state = sampler.run_mcmc(state, ahead, skip_initial_state_check=True)
        chain = np.concatenate([chain, sampler.get_chain()])
        score = np.concatenate([score, sampler.get_log_prob()])
        accepted = accepted + sampler.backend.accepted
        figures = judge(chain, float(accepted.mean() / len(chain)))
        if path:
            save_checkpoint(path, problem, chain, score, accepted, state.random_state)
        if say:
            say(figures)
    return Chain(chain[figures.burn :], score[figures.burn :], figures)


def find_modes(chain: np.ndarray) -> list[dict]:
    """Groups of walkers that never visit each other's region, over the second half of a chain.

    chain: (steps, walkers, k). For each parameter the walkers are cut at the widest gap between
    their means; the two sides are modes where the gap exceeds twice the spread of the walkers on
    either side around their own means and means alike. Returns [] or two dicts
    {"column", "walkers", "centre"}.
    """
    late = chain[len(chain) // 2 :]
    best = []
    widest = 2.0
    for column in range(chain.shape[2]):
        means, spreads = late[:, :, column].mean(axis=0), late[:, :, column].std(axis=0)
        order = np.argsort(means)
        gaps = np.diff(means[order])
        cut = int(np.argmax(gaps)) + 1
        low, high = order[:cut], order[cut:]
        inner = max(np.median(spreads[low]), np.median(spreads[high]), means[low].std(), means[high].std(), 1e-300)
        ratio = gaps[cut - 1] / inner
        if ratio > widest:
            widest = ratio
            best = [{"column": column, "walkers": len(s), "centre": float(means[s].mean())} for s in (low, high)]
    return best


def complaint(model, chain, figures: Figures, rules: Rules) -> str:
    """The sentence of a chain that did not converge: figures, cause where one is seen, hint."""
    low, high = rules.acceptance
    text = (
        f"model {model.name}: the chain did not converge in {figures.steps} steps: {figures.taus:.0f} "
        f"autocorrelation times after the burn-in (at least {rules.taus:g}), acceptance {figures.acceptance:.2f} "
        f"({low:g} to {high:g}), split R-hat {figures.rhat:.3f} (below {rules.rhat:g}). "
    )
    # Later moves may jump from mode to mode, too seldom: what keeps walkers apart shows before these.
    modes = find_modes(chain[:LEARN]) or find_modes(chain)
    if modes:
        name = model.names[modes[0]["column"]]
        prior = model.free[name]
        where = " and ".join(f"{m['walkers']} walkers near {name} = {prior.value(m['centre']):.4g}" for m in modes)
        return text + (
            f"Walkers are stuck in two modes: {where}. Hold that parameter fixed at a measured value, narrow its "
            "prior, or add readings that separate the two"
        )
    if figures.acceptance < low:
        return (
            text + "Acceptance is low: raise [calibrate] walkers, or tighten the priors of parameters unseen by data"
        )
    return text + "Raise [calibrate] max_steps, or hold a parameter that the data do not see (free = false)"
