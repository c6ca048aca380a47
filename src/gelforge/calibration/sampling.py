"""Ensemble sampling that goes on until the chain meets convergence criteria."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from gelforge.calibration.posterior import Posterior
from gelforge.errors import BadInput, GelforgeError

if TYPE_CHECKING:
    import emcee

LEARN = 300  # steps of a warm-up run, later discarded; the next run's proposal is fitted to its second half
LEARNT = 4  # number of warm-up runs
CHUNK = 600  # least steps between checks; half of the chain once that is more
STARTS = 200  # draws from the priors per walker; walkers start at the most probable ones
TAIL = 5.0  # degrees of freedom of the fitted proposal, whose tails are heavier than the posterior's
INDEPENDENT = 0.5  # fraction of steps that use it, after the first warm-up run
# Vehtari, Gelman, Simpson, Carpenter, Bürkner (2021, Bayesian Analysis 16:667) advise 1.01 for four long chains. Here
# each of dozens of walkers is a chain of n autocorrelation times, and chance alone leaves 1 + 1/n, 1.02 at 50 and a bit
# more in the worst of a dozen parameters. Walkers that never visit each other's region leave 1.1 and more.
LARGEST_RHAT = 1.04


@dataclass(frozen=True)
class Rules:
    """Convergence criteria: autocorrelation times kept after burn-in, and R-hat. max_steps: bound on the chain."""

    taus: float
    max_steps: int
    seed: int
    rhat: float = LARGEST_RHAT


@dataclass(frozen=True)
class Figures:
    """Diagnostics of a chain; tau and rhat are the worst over the parameters.

    tau: autocorrelation time by emcee, steps. taus: how many of these are kept. rhat: R-hat with each walker as a
    chain; unlike the autocorrelation time it detects walkers that never visit each other's region. worst: the
    parameter with that R-hat.
    """

    steps: int
    burn: int
    tau: float
    taus: float
    acceptance: float
    rhat: float
    worst: str

    def meets(self, rules: Rules) -> bool:
        return self.taus >= rules.taus and self.rhat < rules.rhat


@dataclass(frozen=True)
class Chain:
    """coordinates: (steps, walkers, free) of the whole chain; the first figures.burn steps are burn-in."""

    coordinates: np.ndarray
    figures: Figures

    def flat(self, size: int | None = None) -> np.ndarray:
        """Draws (size, free), evenly spaced over the chain after its burn-in; all of them where size is None."""
        flat = self.coordinates[self.figures.burn :].reshape(-1, self.coordinates.shape[-1])
        return flat if size is None or size >= len(flat) else flat[np.linspace(0, len(flat) - 1, size).astype(int)]


class NotConverged(GelforgeError):
    """A chain that cannot be trusted. The message holds the figures and the hint; `chain` is as far as it came."""

    def __init__(self, message: str, chain: Chain) -> None:
        super().__init__(message)
        self.chain = chain


def sample(posterior: Posterior, rules: Rules, say: Callable[[Figures], None] | None = None) -> Chain:
    """Sample until the rules are met; raise NotConverged with the figures if max_steps do not suffice.

    At first walkers move by differences of the ensemble. Later, half of the steps are independent draws of Student's
    t fitted to the warm-up, so that a walker forgets its position. The fit is fixed, so this is plain
    Metropolis-Hastings (Tierney 1994, Annals of Statistics 22:1701, section 2.3.3). say: called with the figures at
    every check.
    """
    import emcee
    from emcee import moves

    size = len(posterior.model.free)
    walkers = 2 * size + 2  # at least twice the parameters, and even
    rng = np.random.default_rng(rules.seed)
    state = emcee.State(
        start_points(posterior, walkers, rng), random_state=np.random.RandomState(rules.seed).get_state()
    )
    ensemble = [(moves.DEMove(), 0.7), (moves.StretchMove(), 0.3)]
    sampler = emcee.EnsembleSampler(walkers, size, posterior, vectorize=True, moves=ensemble)
    for _ in range(LEARNT):
        state = sampler.run_mcmc(state, LEARN, skip_initial_state_check=True)
        proposal = moves.MHMove(independent_draws(sampler.get_chain(discard=LEARN // 2, flat=True)))
        mixed = [(proposal, INDEPENDENT), *((move, (1.0 - INDEPENDENT) * weight) for move, weight in ensemble)]
        sampler = emcee.EnsembleSampler(walkers, size, posterior, vectorize=True, moves=mixed)
    while True:
        ahead = min(max(CHUNK, sampler.iteration // 2), rules.max_steps - sampler.iteration)
        state = sampler.run_mcmc(state, ahead, skip_initial_state_check=True)
        figures = judge(sampler, posterior.model.names)
        if say:
            say(figures)
        if figures.meets(rules):
            return Chain(sampler.get_chain(), figures)
        if figures.steps >= rules.max_steps:
            half = Chain(sampler.get_chain(), replace(figures, burn=figures.steps // 2))
            values = posterior.model.values(half.flat())
            medians = {name: float(np.median(values[name])) for name in posterior.model.free}
            raise NotConverged(complaint(figures, rules, posterior.model.beyond_priors(medians)), half)


def start_points(posterior: Posterior, walkers: int, rng: np.random.Generator) -> np.ndarray:
    """Walkers' first coordinates (walkers, free): the most probable of many draws from the priors, each once.

    Drawing from the prior, not from a ball around one optimum, lets a second mode be found.
    """
    draws = posterior.model.draw(rng, STARTS * walkers)
    score = posterior(draws)
    finite = np.isfinite(score)
    if finite.sum() < walkers:
        raise BadInput(
            f"only {finite.sum()} of {len(draws)} draws from the priors have a probability under {posterior.model.law}, and"
            f" {walkers} are needed to begin with; check the priors in [calibrate.priors] and the units of the log"
        )
    return draws[finite][np.argsort(-score[finite])[:walkers]]


def independent_draws(past: np.ndarray):
    """Proposal for emcee's MHMove: draws of Student's t with the moments of `past` (s, k), and log q(old) - log q(new)."""
    centre, size = past.mean(axis=0), past.shape[1]
    covariance = np.atleast_2d(np.cov(past, rowvar=False))
    root = np.linalg.cholesky(covariance + 1e-12 * np.diag(past.var(axis=0)))
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


def judge(sampler: "emcee.EnsembleSampler", names: tuple[str, ...]) -> Figures:
    """Figures of emcee's sampler; ten autocorrelation times are burn-in, half of the chain at most."""
    from arviz_stats.base import array_stats

    steps = sampler.iteration
    tau = float(np.max(sampler.get_autocorr_time(tol=0)))
    accepted = float(sampler.acceptance_fraction.mean())
    if not np.isfinite(tau):  # no walker moved along one of the parameters
        return Figures(steps, steps, float(steps), 0.0, accepted, np.inf, names[0])
    burn = min(int(10 * tau), steps // 2)
    rhat = array_stats.rhat(sampler.get_chain(discard=burn), chain_axis=1, draw_axis=0)
    worst = int(np.argmax(rhat))
    return Figures(steps, burn, tau, (steps - burn) / tau, accepted, float(rhat[worst]), names[worst])


def complaint(figures: Figures, rules: Rules, beyond: list[str]) -> str:
    """Message for a chain that did not converge: figures, where walkers differ, hint. beyond: BenchModel.beyond_priors."""
    text = (
        f"The chain did not converge in {figures.steps} steps: {figures.taus:.0f} autocorrelation times after the"
        f" burn-in (at least {rules.taus:g}), acceptance {figures.acceptance:.2f}, R-hat {figures.rhat:.3f} (below"
        f" {rules.rhat:g}), the largest that of {figures.worst}. "
    )
    if beyond:
        return text + " ".join(beyond)
    if figures.taus >= rules.taus:
        return text + (
            f"Walkers disagree on {figures.worst}, as if it had two modes: fix it at a measured value (free = false), narrow its prior,"
            " or add readings that separate the two"
        )
    return text + "Raise [calibrate] max_steps, or fix a parameter that the data do not determine (free = false)"
