"""What is fitted beside a network that reads pairs of pictures: limits of good pairs, readers of dots, intervals."""

import copy
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from gelforge.flow.params.tables import TrainingTable
from gelforge.networks.agreement import APART_NOTHING, fit_blend
from gelforge.networks.augment import narrow_views
from gelforge.networks.batches import generator
from gelforge.networks.data import Data, data_version, rows_for_intervals, rows_to_judge_by
from gelforge.networks.dotreader import DotReader, dot_presses, motions, train_dot_reader
from gelforge.networks.dots import PrintedDots
from gelforge.networks.goingon import known_before
from gelforge.networks.halves import rounded
from gelforge.networks.inputs import needs_untouched
from gelforge.networks.intervals import fit_intervals, tells_intervals
from gelforge.networks.modelfile import Trained
from gelforge.networks.placereader import PlaceReader, train_place_reader
from gelforge.networks.statistics import RELIEF_MARGIN, pair_evidence, pair_limits, relief
from gelforge.networks.unrolled import pooled_count
from gelforge.networks.use import Predicted, tell_rows
from gelforge.records.markers import pitch_of
from gelforge.records.splits import TRAINING, VALIDATION

# A network that learnt from more sensors is for those that it never saw: their users have untouched pictures of their own.
MOST_PICTURES = 8
ENOUGH_PAIRS = 200  # pictures that tell what good pairs are like


def beside_untouched(
    trained: Trained, data: Data, own: Data, settings: TrainingTable, start: Trained | None
) -> Trained:
    """A network that reads pictures beside untouched ones with what only such a one has: limits, dots, untouched sensors.

    data: what it learnt from. own: the one dataset of it whose unseen sensors tell how far it is off, and whose untouched
    sensors it is for: those of others bear names in `data` that no user knows.
    """
    pictures = own.nocontact if len(own.nocontact) <= MOST_PICTURES else {}
    about = trained.about | learnt_pitch(data, start)
    if start is not None and not tells_intervals(own.presses(rows_for_intervals(own))):
        rows = np.concatenate([data.splits[TRAINING], data.splits[VALIDATION]])
        images = (np.ascontiguousarray(data.images[row]) for row in rows)
        about |= known_before(start.about, images, good_pairs(data, rows), about["best_epoch"] > 0)
        trained = replace(trained, about=about, untouched=pictures, **readers_of(start))
        return kept_above(trained, start, data)
    about |= {"statistics": about["statistics"] | good_pairs(data, usual_rows(data))}
    by_dots, places = readers_of_dots(data, settings)
    if places:
        about |= {"places": {"data": data.name, "pictures": len(data.splits[TRAINING])}}
    if start is not None:
        before = readers_of(start)
        by_dots, places = by_dots or before["dots"], places or before["places"]
        about = {"places": start.about.get("places")} | about
    return judged(replace(trained, about=about, untouched=pictures, dots=by_dots, places=places), own, start)


def readers_of(start: Trained) -> dict[str, Any]:
    """The readers of dots beside a network that is gone on from, as a file of them will keep them."""
    found = {"dots": start.dots, "places": start.places}
    return {name: None if reader is None else rounded(copy.deepcopy(reader)) for name, reader in found.items()}


def sights(data: Data, reads: str, settings: TrainingTable) -> Callable[[int], np.ndarray]:
    """What a picture that the network reads may look like, by row, (h, w, 3) uint8: every other one of a narrow view."""
    narrow = replace(settings.augment, narrowed_share=0.5 if settings.augment.narrowed_share else 0.0)

    def see(row: int) -> np.ndarray:
        pair = data.seen([row], reads)
        if needs_untouched(reads):
            pair, _, _ = narrow_views(pair, data.labels[[row]], narrow, generator(settings.seed, "view", 0, row))
        return pair[0, ..., :3]

    return see


def usual_rows(data: Data) -> np.ndarray:
    """Rows whose pairs tell what good ones are like: validation's, and where these are few some that trained, evenly picked.

    What a pair is like has nothing to do with what a network learnt from it.
    """
    rows, trained = data.splits[VALIDATION], data.splits[TRAINING]
    picked = np.linspace(0, len(trained) - 1, min(max(ENOUGH_PAIRS - len(rows), 0), len(trained))).astype(int)
    return np.concatenate([rows, trained[picked]])


def good_pairs(data: Data, rows: np.ndarray) -> dict[str, float]:
    """Limits of what the pairs of some rows are like (networks.statistics)."""
    names = data.names("sensor_id")[rows]
    dots = {name: PrintedDots(data.nocontact[name]) for name in sorted(set(names.tolist()))}
    pairs = [
        pair_evidence(np.ascontiguousarray(data.images[row]), data.nocontact[name], dots[name])
        for row, name in zip(rows, names, strict=True)
    ]
    return pair_limits(pairs) | {"largest_relief": RELIEF_MARGIN * max(relief(data.nocontact[name]) for name in dots)}


def readers_of_dots(data: Data, settings: TrainingTable) -> tuple[DotReader | None, PlaceReader | None]:
    """Readers of force and of place from printed dots (networks.dotreader, .placereader).

    None for one that is not asked for, or where a sensor shows no print.
    """
    if not settings.dot_epochs and not settings.place_epochs:
        return None, None
    dots = {name: PrintedDots(picture) for name, picture in data.nocontact.items()}
    if not all(one.known for one in dots.values()):
        return None, None
    rows, by_dots, places = data.splits[TRAINING], None, None
    motion = motions(data, rows, dots)
    if settings.dot_epochs:
        presses = dot_presses(data, rows, dots, motion)
        by_dots = train_dot_reader(presses, settings.dot_epochs, settings.seed, settings.augment)
    if settings.place_epochs:
        places = train_place_reader(motion, settings.place_epochs, settings.seed)
    return by_dots, places


def judged(trained: Trained, data: Data, start: Trained | None) -> Trained:
    """A network with how its two readers meet, and how far what `predict` tells is off.

    Both are set on what `predict` makes of pictures that training did not see, with light, tare and placement. A reader of
    dots that could not be judged has no say, as beside a network that only knows totals.
    """
    if tuple(trained.about["grid"]) != tuple(data.grid):
        return replace(trained, dots=None)
    about = trained.about | met(trained, data)
    trained = replace(trained, about=about, dots=trained.dots if "dots" in about else None)
    if start is not None:
        trained = kept_above(trained, start, data)
    return replace(trained, about=trained.about | held(trained, data))


def kept_above(trained: Trained, start: Trained, data: Data) -> Trained:
    """A network with what stands above the readers of the one that it went on from, where that still serves it.

    It learnt how the other one errs. Pictures of validation tell whether this one, whose weights moved since, errs alike.
    """
    if start.stacking is None or trained.dots is None or pooled_count(trained.net) != pooled_count(start.net):
        return trained
    above = replace(
        trained,
        about=trained.about | {"stacking": start.about["stacking"]},
        stacking=copy.deepcopy(start.stacking),
    )
    rows = data.splits[VALIDATION]
    told = [tell_rows(one, data, rows).forces.sum((2, 3), dtype=float)[:, 2] for one in (trained, above)]
    without, beneath = (np.abs(normal - data.totals(rows)[:, 2]).mean() for normal in told)
    return above if beneath < without else trained


def met(trained: Trained, data: Data) -> dict[str, Any]:
    """What a model's description says of how its two readers meet; empty where nothing reads dots or tells it.

    Pictures of unseen sensors and those of validation decide, each with half the say: the first show few shapes, the second
    no unseen sensor.
    """
    if trained.dots is None:
        return {}
    alone = replace(trained, about=trained.about | {"dots": APART_NOTHING}, stacking=None)
    unseen = rows_to_judge_by(data)
    groups = [rows for rows in (unseen, np.setdiff1d(data.splits[VALIDATION], unseen)) if len(rows)]
    parts = [
        (told, data.labels[rows]) for rows in groups if (told := tell_rows(alone, data, rows)).by_dots is not None
    ]
    return {"dots": meet(parts)} if parts else {}


def held(trained: Trained, data: Data) -> dict[str, Any]:
    """What a model's description says of how far what `predict` tells is off."""
    rows = rows_for_intervals(data)
    sensors = sorted(set(data.names("sensor_id")[rows].tolist()))
    intervals = fit_intervals(tell_rows(trained, data, rows).forces, data.labels[rows], data.presses(rows))
    return {"intervals": intervals | {"sensors": sensors, "data": data.name, "version": data_version(data)}}


def meet(parts: Sequence[tuple[Predicted, np.ndarray]]) -> dict[str, Any]:
    """How the two readers meet best on parts of a dataset with as much say each; labels (n, 3, rows, cols) N."""
    by_picture = np.concatenate([told.forces.sum((2, 3), dtype=float) for told, _ in parts])
    by_dots = np.concatenate([told.by_dots for told, _ in parts])
    true = np.concatenate([labels.sum((2, 3), dtype=float) for _, labels in parts])
    counts = np.concatenate([np.full(len(labels), 1.0 / len(labels)) for _, labels in parts])
    return fit_blend(by_picture, by_dots, true, counts)


def learnt_pitch(data: Data, start: Trained | None = None) -> dict[str, list[float]]:
    """Least and largest distance in px of the dots on the untouched sensors that training saw, and that `start` knew.

    Nothing where none has dots.
    """
    names = set(data.names("sensor_id")[data.splits[TRAINING]].tolist())
    pitches = [pitch for pitch in (pitch_of(data.nocontact[name]) for name in sorted(names)) if pitch]
    pitches += start.about.get("pitch_px", []) if start is not None else []
    return {"pitch_px": [min(pitches), max(pitches)]} if pitches else {}
