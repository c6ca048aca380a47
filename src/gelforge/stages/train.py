"""Stage 70: train one network of workflow/models.toml on one dataset.

The curve lies inside the model file and, as a table, beside it.
"""

from argparse import Namespace
from pathlib import Path

from gelforge.errors import BadInput
from gelforge.flow.files import publish, read_json, write_csv
from gelforge.flow.layout import beside
from gelforge.flow.main import command, option
from gelforge.flow.params import laid_over, plain
from gelforge.flow.params.schema import Place, parse
from gelforge.flow.params.slices import ForTrain, read_slice
from gelforge.flow.params.tables import SHIPPED, TrainingTable, TrainTable
from gelforge.records.networkkind import kind_of

VERSION = 20


def read_models(path) -> dict:
    """Read the model table, TOML as written or JSON as stage 00 leaves it."""
    from gelforge.flow.params import read_toml

    return read_json(path) if Path(path).suffix == ".json" else read_toml(path)


def resolve(models: dict, name: str, train: TrainTable) -> tuple[dict, TrainingTable]:
    """Return the table of model `name` and the training settings with those of its kind and its own laid over them."""
    if name not in models:
        raise BadInput(f"MODEL={name}: no such model in workflow/models.toml; known: {', '.join(sorted(models))}")
    model = dict(models[name])
    if model.get("start", SHIPPED) != SHIPPED:
        raise BadInput(
            f"workflow/models.toml, [{name}]: start = {model['start']!r}: only {SHIPPED!r} can be gone on from"
        )
    kind_of(model)  # which refuses what is no kind
    own = model.pop("train", {})
    values = plain(train)
    del values["also"]  # it says what is learnt from, not how
    of_kind = values.pop("epochs_of").get(model["kind"], 0)
    values["epochs"] = of_kind or train.epochs
    model.pop("note", None)
    place = Place("workflow/models.toml", (name, "train"))
    return model, parse(TrainingTable, laid_over(values, own), place)


def train(data, name: str, model: dict, settings: TrainingTable, checkpoint=None, start=None, also=()):
    """A model of a dataset, networks.newmodel.make_model of this VERSION; make_stacked where that is all that learns."""
    from gelforge.networks.newmodel import make_model, make_stacked

    if settings.stacking_epochs:
        if start is None:
            raise BadInput(
                f"workflow/models.toml, [{name}]: stacking_epochs = {settings.stacking_epochs}: what stands above both readers"
                f' learns beside a network that is there: say start = "{SHIPPED}"'
            )
        return make_stacked(data, name, model, settings, start, also)
    return make_model(data, name, model, settings, VERSION, checkpoint, start, also)


@command(
    option("--dataset", type=Path, help="60_dataset/RES"),
    option("--also", type=Path, nargs="*", default=[], help="60_dataset/RES of other datasets to learn from"),
    option("--model", help="name of a table in --models"),
    option("--models", type=Path, default=Path("workflow/models.toml")),
    option("--params", type=Path),
    option("--part", default="", help="presses_N or units_N: learn from so many of them only (default: all)"),
    option("--out", type=Path),
)
def main(args: Namespace) -> None:
    from gelforge.networks import use
    from gelforge.networks.data import open_data
    from gelforge.networks.modelfile import load_model, save_model
    from gelforge.networks.part import as_many_passes, parse_part, take_part
    from gelforge.reporting.networkcharts import draw_curve

    model, settings = resolve(read_models(args.models), args.model, read_slice(args.params, ForTrain).train)
    checkpoint = beside(args.out, ".checkpoint.pt")
    data = open_data(args.dataset)
    if args.part:
        whole, data = data, take_part(data, parse_part(args.part), settings.seed)
        settings = as_many_passes(settings, data, whole)
    start = load_model(use.SHIPPED) if model.pop("start", None) else None
    also = [open_data(folder) for folder in args.also]
    trained = train(data, args.model, model, settings, checkpoint, start, also)
    curve = trained.about["curve"]
    write_csv(beside(args.out, ".curve.csv"), list(curve[0]), curve)
    with publish(beside(args.out, ".curve.png")) as part:
        draw_curve(part, curve, trained.about["best_epoch"], args.model)
    save_model(args.out, trained)
    checkpoint.unlink(missing_ok=True)
    cost = trained.about["cost"]
    print(
        f"best epoch {trained.about['best_epoch']}, {cost['seconds']:.0f} s in {cost['steps']} steps, waited "
        f"{100 * cost['wait_seconds'] / max(cost['step_seconds'], 1e-9):.1f} % of a step for data, peak {cost['peak_gib']:.2f} GiB"
    )


if __name__ == "__main__":
    main.exit()
