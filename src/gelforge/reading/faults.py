"""Faults of a sensor's images: the one table of what is measured, its limit, its sentence, and who asks for it.

Stage 15 (with stage 60 for imported labels) asks for the faults that make an image useless in a dataset: it is not of
this sensor, or the camera failed. A reader asks for the same, and then for what makes its network read a wrong force.
Both measure one `Pair`, so a fault that both ask for is found by both or by none.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Flag, auto
from typing import Any

from gelforge.reading import measures
from gelforge.reading.frame import BLUE_FIRST, SAME_SHAPE
from gelforge.reading.pair import Framed, NoContact, Pair
from gelforge.reading.picture import Picture


class Asked(Flag):
    """Who asks for a fault: the judge of a log's images, a reader, or both."""

    LOG = auto()
    READER = auto()
    BOTH = LOG | READER


@dataclass(frozen=True)
class Fault:
    """A measure of a subject outside of least to most, and what is said of it.

    text: with {value}, the limits {least} and {most}, and the subject {of}; or a function of the subject. asked: by whom.
    data: what set the limit.
    """

    measure: Callable[[Any], float]
    text: str | Callable[[Any], str]
    data: str
    least: float = -math.inf
    most: float = math.inf
    asked: Asked = Asked.BOTH

    def of(self, subject: Any) -> str:
        """What is wrong with a subject; empty where its measure is within the limits."""
        value = self.measure(subject)
        if self.least <= value <= self.most:
            return ""
        if callable(self.text):
            return self.text(subject)
        return self.text.format(value=value, least=self.least, most=self.most, of=subject)


def first_fault(faults: Sequence[Fault], subject: NoContact | Framed, asked: Asked) -> str:
    """The first of some faults that a subject has and that somebody asks for; empty where it has none."""
    return next((text for one in faults if one.asked & asked and (text := one.of(subject))), "")


def of_gel(of: str, shows: str, picture: Callable[[Any], Picture]) -> tuple[Fault, Fault]:
    """Faults of one picture by itself: no contrast, no colour. of: its name; shows: what it then lacks; picture: from a subject."""
    return (
        Fault(
            lambda subject: picture(subject).contrast,
            f"the {of} shows {shows}: it is dark, covered or of one colour",
            "levels of any gel's image span more",
            least=30.0,
        ),
        Fault(
            lambda subject: picture(subject).colour if subject.coloured else math.inf,
            f"the {of} is monochrome, but colours are compared: set the camera to colour (RGB or BGR)",
            "colours of one pixel differ by 1 level in images converted from grey, by 20 and more in those of a Mini",
            least=1.5,
        ),
    )


NOCONTACT = (
    Fault(
        lambda rest: float(not rest.expects_markers or rest.markers.printed.pitch > 0.0),
        "the no-contact image shows no markers, unlike those of training: it is blurred, or of another gel",
        "a network that learnt from marked gels reads nothing of another gel",
        least=1.0,
        asked=Asked.READER,
    ),
    Fault(
        lambda rest: rest.stretch,
        "the no-contact image is stretched: its markers stand {value:.2f} times as far apart one way as the other; give images as the camera"
        " takes them, or crop them",
        "1.05 at most in 45 sensors (films, FEATS, balls, demo); 1.33, images of 4:3 squeezed into a square, changes forces by -9 to +23 %",
        most=1.15,
        asked=Asked.READER,
    ),
    *of_gel("no-contact image", "no gel", lambda rest: rest.picture),
    Fault(
        lambda rest: rest.picture.level,
        "the no-contact image is dark: its mean level is {value:.0f} of 255, at least {least:.0f} is usual; check the lamps and the exposure",
        "real units have 78 to 122",
        least=40.0,
    ),
    Fault(
        lambda rest: rest.picture.sharpness if rest.markers.printed.pitch else math.inf,
        "the no-contact image is blurred: its sharpness is {of.picture.sharpness:.1f}, at least {least:.1f} is usual; focus the camera and hold"
        " it still",
        "0.45 below the least of 332 units that the shipped network learnt from",
        least=2.059,
    ),
    Fault(
        lambda rest: rest.pale,
        "the markers of the no-contact image are pale: they are worn, or their print differs from that of the sensors in training",
        "fraction of half-worn markers in both images at which forces are within 10 %, in the demo",
        most=0.33,
    ),
    Fault(
        lambda rest: float(rest.frame.blue_first),
        BLUE_FIRST,
        "exchanged colours look like a camera that is mirrored, and a Mini's blue light is its brightest",
        most=0.0,
        asked=Asked.READER,
    ),
)

# Of a no-contact image whose forces may still be right: a reader says it once and flags no image for it.
TOUCH = Fault(
    lambda rest: rest.touch,
    "something seems to touch the gel in the no-contact image, or dirt lies on it: between its markers the light is uneven",
    "3 of 108 clean images of rendered units and 1 of 44 real ones exceed it, and all of 245 presses of 0.5 N and more",
    most=1.0,
)

# The order decides which of several faults is named. What both ask for stands first.
IMAGE = (
    Fault(
        lambda seen: abs(seen.given[1] * seen.expected[0] / (seen.given[0] * seen.expected[1]) - 1.0),
        "the image is {of.given[1]} x {of.given[0]}; its aspect ratio differs from that of the no-contact image or of training"
        " ({of.expected[1]} x {of.expected[0]}): take all images in one mode of the camera, or crop them",
        "a stretch by 2 % changes forces by less than 10 %",
        most=SAME_SHAPE,
    ),
    *of_gel("image", "nothing of this sensor", lambda seen: seen.image),
)
PAIR = (
    *IMAGE,
    Fault(
        measures.sharper,
        "the image is blurred compared with its no-contact image, or of another unit: focus the camera, and take images while nothing moves",
        "100 pairs of real balls and the demo, blurred by 0.6 to 3 px: 90 % of the forces are within 10 % above it, a fifth of them off below",
        least=-2.2,
    ),
    Fault(
        measures.whiter,
        "the image is overexposed, more than {most:.0%} of its pixels are white: shorten the exposure",
        "none of 130 images of real sensors has white pixels",
        most=0.1,
    ),
    Fault(
        measures.brighter,
        "the image is more than {most:g} times brighter or darker than its no-contact image: take a no-contact image under the light of"
        " the presses",
        "34 pairs of real balls and the demo: forces change by 1 % at 1.54, by over 10 % in half of them at 2",
        most=1.8,
    ),
    Fault(
        measures.tear,
        "the image is torn: along one row it changes as if its lower part were of another frame; check the camera's cable and its rate",
        "the largest of 703 whole pairs (films, FEATS, balls, rig) has 0.95, of 72 drags by up to half a pitch 0.6; benchmark-torn counts"
        " what is read wrong of frames torn at random rows",
        most=1.0,
    ),
    Fault(
        lambda pair: float(bool(measures.flipped(pair))),
        lambda pair: f"the image is {measures.flipped(pair)} compared with the no-contact image",
        "a turned pattern fits better than the own one by 0.1, and its light is that of the sensor: in none of 579 own pairs",
        most=0.0,
    ),
    Fault(
        measures.crowd,
        "the image shows {value:.2f} times as many markers as the no-contact image: crop and scale both alike",
        "at most 1.14 in real films, 1.8 in one that is cropped by a seventh",
        most=1.35,
    ),
    Fault(
        measures.dark_likeness,
        "the image shows nothing of this sensor: it is dark, covered or of something else",
        "at least 0.59 in 579 own pairs (films, balls, rig), 0.49 to 0.64 beside another unit",
        least=0.4,
    ),
    Fault(
        measures.lit_likeness,
        "the image and the no-contact image are of different sensors: their light comes from different sides",
        "at least 0.625 in 579 own pairs whose light differs (films, balls, rig); below 0.62 in 90 % of other units' pairs",
        least=0.62,
    ),
    Fault(
        measures.distance,
        "the image and the no-contact image are of different sensors",
        "1.5 times the 99 % quantile of 422 good pairs of units of the rig; at most 4.7 in real balls",
        most=15.0,
    ),
    Fault(
        measures.residual,
        "too little of the image matches the no-contact image",
        "1.5 times the 99 % quantile of 422 good pairs of units of the rig",
        most=32.4,
    ),
    Fault(
        measures.agreeing,
        "too little of the image matches the no-contact image",
        "the 1 % quantile of 422 good pairs of units of the rig over 1.5",
        least=0.438,
    ),
    Fault(
        measures.rim_px,
        "the rim of the gel moved by {value:.1f} px since the no-contact image: the image is of another unit, or the gel was moved",
        "1 px above the 99 % quantile of 422 good pairs of units of the rig",
        most=5.07,
    ),
    Fault(
        measures.uneven,
        "the marker pattern differs from that of the no-contact image: they are of different sensors, or its markers cannot be tracked",
        "1.5 times the 99 % quantile of 422 good pairs of units of the rig; at most 0.23 in 179 others",
        most=0.566,
    ),
    Fault(
        measures.alike_px,
        "nearly all markers moved by at least {value:.1f} px: the gel is mounted differently than in the no-contact image, or the no-contact"
        " image is of another gel",
        "0.4 % of 700 presses of the rig, drags included, none of 238 frames of real films against their own no-contact image",
        most=1.0,
    ),
    Fault(
        measures.other_look,
        "{value:.0%} of its markers do not look like those of the no-contact image: the image is of another gel, or blurred",
        "99 % of 238 frames of real films against the gripper's other finger, none against their own no-contact image",
        most=0.5,
    ),
    Fault(
        measures.faint,
        "{value:.0%} of its markers are fainter than in the no-contact image: take a new no-contact image, focus the camera, or change the gel",
        "fraction of half-worn markers in the image alone at which forces are within 10 %, in the demo",
        most=0.25,
        asked=Asked.READER,
    ),
    *(
        Fault(
            measure,
            "its markers moved by {value:.0%} of their pitch: farther than in training, so that a marker may be taken for its neighbour; drag"
            " the gel less",
            "beyond are all of 132 drags by 1.5 to 2.5 mm (rig, four bodies, six units), whose forces are predicted half too small",
            most=most,
            asked=Asked.READER,
        )
        for measure, most in ((measures.farthest, 0.6), (measures.stretch, 0.45), (measures.farthest_of_lost, 0.4))
    ),
    Fault(
        measures.unmatched,
        "the light of the image cannot be matched to that of the no-contact image",
        "a network that compares two images takes a change of light that cannot be undone for force",
        most=0.0,
        asked=Asked.READER,
    ),
)
# What a reader flags where it changes a force by more than the interval: with the pair that lacks it.
EFFECTS: tuple[tuple[Fault, Callable[[Pair], Pair]], ...] = (
    (
        Fault(
            lambda pair: float(pair.vanished),
            "{of.vanished} markers are visible only in the image or only in the no-contact image: take a new no-contact image, or change the gel",
            "of 63: with so many painted over in both images, 90 % of the forces are within 11 %",
            most=8.0,
            asked=Asked.READER,
        ),
        lambda pair: pair.unhidden or pair,
    ),
    (
        Fault(
            lambda pair: pair.fall,
            "the light is distributed differently than in the no-contact image, by {value:.0%} of its level from the middle to the edge: take a"
            " new no-contact image under the present light",
            "216 pairs of 12 unseen units of the rig: wrong by over 15 % of the range no more often above 0.12 than below 0.02; real FEATS presses change by up to 10 % at 0.2",
            most=0.2,
            asked=Asked.READER,
        ),
        Pair.evenly_lit,
    ),
)
LEAST_PULL = 1.0  # N above which a prediction that no contact can make is flagged


def nocontact_fault(nocontact: NoContact, asked: Asked) -> str:
    """What is wrong with a no-contact image by itself; empty where nothing is. Of a touch a reader says less (TOUCH)."""
    return first_fault(NOCONTACT if asked is Asked.READER else (*NOCONTACT, TOUCH), nocontact, asked)


def pair_fault(seen: Framed, asked: Asked) -> str:
    """What is wrong with an image, and with its pair where it has one; empty where nothing is."""
    return first_fault(PAIR if isinstance(seen, Pair) else IMAGE, seen, asked)


def other_sensor(pair: Pair) -> str:
    """Whether an image and its pair are of different sensors, wherever the gel sits; empty where they may be of one."""
    of = (measures.crowd, measures.lit_likeness, measures.distance, measures.uneven)
    return first_fault([fault for fault in PAIR if fault.measure in of], pair, Asked.BOTH)


def pull_fault(normal: float) -> str:
    """Fault of a predicted total normal force in N that pulls on the gel; empty where it presses."""
    if normal < LEAST_PULL:
        return ""
    return f"the gel seems to pull with {normal:.1f} N: something may have touched it in the no-contact image"
