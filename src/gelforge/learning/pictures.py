"""The pictures of a dataset as networks see them, written once by stage 60 and taken as they are ever after.

| file | holds |
| --- | --- |
| images.npy | (n, h, w, 3) uint8 RGB, as logged: what a network reads that reads the image alone |
| pairs.npy | (n, h, w, 3) uint8 RGB: the image under the light of its no-contact image, registered, without worn markers |
| nocontact.npy | (m, h, w, 3) uint8 RGB: the no-contact image of each sensor, then those without worn markers |
| beside.npy | (n,) int32: the row of nocontact.npy beside each image, -1 for none |
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from gelforge.reading.pair import NoContact
from gelforge.records.rowfile import Rows, write_rows

PICTURES = ("images.npy", "pairs.npy", "nocontact.npy", "beside.npy")


def write_pairs(
    folder: Path, images: np.ndarray | Rows, sensors: Sequence[str], nocontact: Mapping[str, np.ndarray]
) -> None:
    """Write all files but images.npy into a folder.

    images: (n, h, w, 3) uint8 RGB, and `sensors` their names (n,). nocontact: (h, w, 3) uint8 RGB by name; the images of
    other sensors stay as they are.
    """
    shape = images.shape[1:]
    known = {name: NoContact(picture, (shape[0], shape[1])) for name, picture in nocontact.items()}
    places = {name: at for at, name in enumerate(nocontact)}
    beside = np.full(len(images), -1, np.int32)
    count = len(nocontact)
    with (folder / "worn.part").open("wb+") as worn:  # on disk, because a rig's worn images are many

        def pairs():
            nonlocal count
            for row, name in enumerate(sensors):
                image = images[row]
                if name not in known:
                    yield image
                    continue
                pair = known[name].compare(image)
                beside[row] = places[name]
                if pair.nocontact is not known[name]:
                    worn.write(pair.nocontact.picture.image.tobytes())
                    beside[row], count = count, count + 1
                yield pair.lit.image

        write_rows(folder / "pairs.npy", np.uint8, images.shape, pairs())
        worn.seek(0)
        size = int(np.prod(shape))
        bare = (np.frombuffer(worn.read(size), np.uint8).reshape(shape) for _ in range(count - len(nocontact)))
        every = (one for part in (nocontact.values(), bare) for one in part)
        write_rows(folder / "nocontact.npy", np.uint8, (count, *shape), every)
    (folder / "worn.part").unlink()
    np.save(folder / "beside.npy", beside)
