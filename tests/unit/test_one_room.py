"""A fact stands in one room: nobody but the records parses cells, lists their columns or codes pictures."""

import ast
from pathlib import Path

import gelforge
from gelforge.records.networkkind import KINDS
from gelforge.records.press import FORCE, POSE
from gelforge.records.splits import SPLITS, TEST, TRAINING

PACKAGE = Path(gelforge.__file__).parent
APART = "fea_challenge"  # scripts that leave the house: they run where nothing of gelforge is
TREES = {
    str(path.relative_to(PACKAGE)): ast.parse(path.read_text(encoding="utf-8"))
    for path in PACKAGE.rglob("*.py")
    if path.parent.name not in ("records", APART)
}


def calls(tree):
    """Every call of a module as (name of the function, the call)."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            function = node.func
            yield function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", ""), node


def texts(node) -> list:
    """Constants in a literal list or tuple, in order."""
    return [item.value for item in getattr(node, "elts", []) if isinstance(item, ast.Constant)]


def test_pictures_are_coded_and_decoded_by_the_records_alone():
    coders = {"imread", "imdecode", "imwrite", "imencode"}
    assert not [name for name, tree in TREES.items() if coders & {called for called, _ in calls(tree)}]


def test_pools_of_processes_are_made_where_they_end_with_their_maker_alone():
    makers = {"ProcessPoolExecutor", "Pool"}
    assert [name for name, tree in TREES.items() if makers & {called for called, _ in calls(tree)}] == [
        "flow/orphans.py"
    ]


def test_the_columns_of_a_press_are_listed_by_the_records_alone():
    lists = [(name, texts(node)) for name, tree in TREES.items() for node in ast.walk(tree)]
    assert not [name for name, held in lists if set(POSE[:5]) <= set(held) or held == list(FORCE)]


def test_cells_of_a_press_become_numbers_in_the_parser_alone():
    read = [(name, call) for name, tree in TREES.items() for called, call in calls(tree) if called == "float"]
    keys = [(name, node.slice) for name, call in read for node in ast.walk(call) if isinstance(node, ast.Subscript)]
    assert not [name for name, key in keys if isinstance(key, ast.Constant) and key.value in (*POSE, *FORCE)]


def test_what_kinds_of_networks_differ_in_stands_in_their_table_alone():
    """But for their layers. Some kinds have names that are words of other meanings, too."""
    names = KINDS.keys() - {"grid", "unet", "geometry"}
    naming = [
        name
        for name, tree in TREES.items()
        if any(isinstance(node, ast.Constant) and node.value in names for node in ast.walk(tree))
    ]
    assert naming == ["networks/models/registry.py"]


def test_splits_are_named_by_the_records_alone():
    """Two of their names are words of other meanings, too: these are looked for where rows of a split are."""
    names = set(SPLITS) - {TRAINING, TEST}
    walked = [(name, node) for name, tree in TREES.items() for node in ast.walk(tree)]
    assert not [name for name, node in walked if isinstance(node, ast.Constant) and node.value in names]
    keys = [(name, node.slice) for name, node in walked
            if isinstance(node, ast.Subscript) and getattr(node.value, "attr", getattr(node.value, "id", "")) == "splits"]  # fmt: skip
    assert not [name for name, key in keys if isinstance(key, ast.Constant)]


def test_colours_of_forces_are_chosen_in_one_place():
    """Besides, a picture in grey, and a surface that is coloured by how far it moved."""
    colours = [
        (name, keyword.value)
        for name, tree in TREES.items()
        for _, call in calls(tree)
        for keyword in call.keywords
        if keyword.arg == "cmap"
    ]
    chosen = {name: value.value for name, value in colours if isinstance(value, ast.Constant)}
    assert chosen == {"commands/look.py": "gray", "stages/readme.py": "viridis"}
    assert {name for name, value in colours if isinstance(value, ast.Name)} == {"reporting/forcemaps.py"}
