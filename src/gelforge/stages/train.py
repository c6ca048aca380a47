"""Stage 70: train one network of workflow/models.toml on one dataset.

The curve lies inside the model file and, as a table, beside it.
"""

from argparse import Namespace

from gelforge.errors import BadInput
from gelforge.flow.cli import stage
from gelforge.flow.files import publish, read_json, write_csv
from gelforge.flow.layout import Layout, beside
from gelforge.flow.params import laid_over, plain, read_parameters
from gelforge.flow.schema import Place, parse
from gelforge.flow.tables import SHIPPED as SHIPS
from gelforge.flow.tables import TrainingTable, TrainTable
from gelforge.records.networkkind import kind_of

VERSION = 25


def resolve(models: dict, name: str, train: TrainTable) -> tuple[dict, TrainingTable]:
    """Return the table of model `name`, and the training settings overridden by those of its kind and its own.

    BadInput for an unknown name, a start other than the shipped network, or wrong settings.
    """
    if name not in models:
        raise BadInput(f"MODEL={name}: no such model in workflow/models.toml; known: {', '.join(sorted(models))}")
    model = dict(models[name])
    if model.get("start", SHIPS) != SHIPS:
        raise BadInput(
            f"workflow/models.toml, [{name}]: start = {model['start']!r}: only {SHIPS!r} can be fine-tuned"
        )
    kind_of(model)  # refuses an unknown kind
    own = model.pop("train", {})
    values = plain(train)
    del values["also"]  # names training data, no setting of the training
    of_kind = values.pop("epochs_of").get(model["kind"], 0)
    values["epochs"] = of_kind or train.epochs
    model.pop("note", None)
    place = Place("workflow/models.toml", (name, "train"))
    return model, parse(TrainingTable, laid_over(values, own), place)


def train(data, name: str, model: dict, settings: TrainingTable, checkpoint=None, start=None, also=()):
    """A trained model of a dataset, made by learning.train.make_model with this VERSION."""
    from gelforge.learning.train import Recipe, make_model

    return make_model(data, Recipe(name, model, settings, VERSION), checkpoint, start, also)


@stage(Layout.network)
def main(args: Namespace) -> None:
    from gelforge.learning.data import open_data
    from gelforge.learning.start import shipped
    from gelforge.learning.train import save_trained
    from gelforge.reporting.networkcharts import draw_curve

    of = args.of
    params = read_parameters(of.parameters("train")).train
    model, settings = resolve(read_json(of.parameters(f"models/{args.model}")), args.model, params)
    checkpoint = beside(args.out, ".checkpoint.pt")
    data = open_data(of.dataset(args.resolution))
    start = shipped() if model.pop("start", None) else None
    also = [open_data(Layout(of.root.parent / name).lesson(args.resolution)) for name in params.also]
    trained = train(data, args.model, model, settings, checkpoint, start, also)
    curve = trained.metadata["curve"]
    write_csv(beside(args.out, ".curve.csv"), list(curve[0]), curve)
    with publish(beside(args.out, ".curve.png")) as part:
        draw_curve(part, curve, trained.metadata["best_epoch"], args.model)
    save_trained(args.out, trained)
    checkpoint.unlink(missing_ok=True)
    cost = trained.metadata["cost"]
    print(
        f"best epoch {trained.metadata['best_epoch']}, {cost['seconds']:.0f} s in {cost['steps']} steps, waited "
        f"{100 * cost['wait_seconds'] / max(cost['step_seconds'], 1e-9):.1f} % of a step for data, peak {cost['peak_gib']:.2f} GiB"
    )


if __name__ == "__main__":
    main.exit()
