"""Options shared by the commands that read images of a sensor."""

from pathlib import Path

from gelforge.commands.camera import camera_mode
from gelforge.flow.cli import option, positive
from gelforge.reading.model import DEVICES

MODEL = option("--model", type=Path, help="model file (default: the shipped network)", default=None)
SENSOR = option("--sensor", help="name of the sensor; refused if the model is for another one", default=None)
NOCONTACT = option(
    "--nocontact",
    type=Path,
    metavar="IMAGE",
    help="no-contact image: the sensor while nothing touches it",
    default=None,
)
PROFILE = option("--profile", type=Path, help="profile of the sensor, made by `gelforge sensor`", default=None)
MODE = option("--mode", type=camera_mode, metavar="WxH", help="image size to request from the camera", default=None)
ENGINE = (
    option("--device", choices=DEVICES, default="cpu", help="device of the network (default: %(default)s)"),
    option("--threads", type=positive, default=1),
)
