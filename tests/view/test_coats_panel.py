"""The coats on the viewer's page, by a stand-in for viser; and what the command refuses of them."""

import contextlib
from types import SimpleNamespace

import pytest

from irisjax.io.recipes import Recipe
from irisjax.ocularist.recipes import CoatRecipe
from irisjax.view import Bench
from irisjax.view.panels import CoatsPanel

BASE = CoatRecipe("base", {}, "burnt umber", "burnt umber", 0.0, 1.0, 0, 0.0)
LIMBUS = CoatRecipe("limbus", {}, "ivory black", "ivory black", 0.0, 0.6, 2, 0.2)


class Widget(contextlib.nullcontext):
    """Told by the test what a browser would tell it."""

    def __init__(self, value=None, order=None):
        super().__init__()
        self.value, self.order, self.content = value, order, ""

    def on_update(self, call):
        self.call = call

    on_click = on_update

    def becomes(self, value):
        self.value = value
        self.call(SimpleNamespace(target=self, client=object()))


class Gui:
    """Widgets by name, those of a folder by its name and theirs."""

    def __init__(self):
        self.made, self.folder = {}, ""

    def _made(self, label, value=None, order=None, **_):
        self.made[self.folder, label] = widget = Widget(value, order)
        return widget

    add_button = add_checkbox = add_rgb = _made

    def add_folder(self, label, expand_by_default=True):
        self.folder = label
        return self._made("")

    def add_html(self, content, order=None):
        return self._made("html", order=order)

    def add_slider(self, label, low, high, step, value):
        return self._made(label, value)

    def add_button_group(self, label, options):
        return self._made(label, options[0])


@pytest.fixture
def page(tmp_path):
    bench = Bench(Recipe((BASE, LIMBUS), folder=tmp_path), texels=16)
    asked = {}
    panel = CoatsPanel(gui := Gui(), bench, lambda **changes: asked.update(changes))
    panel.results()
    return SimpleNamespace(panel=panel, gui=gui.made, asked=asked, bench=bench, folder=tmp_path)


def test_every_control_asks_for_its_change_on_top_of_the_last(page):
    """A picked colour goes back to the mixture."""
    limbus, base = "02 limbus", "01 base"
    mixed = (0x3C, 0x28, 0x23)
    assert page.gui[base, "colour"].value == mixed
    assert page.gui[limbus, "opacity"].value == 0.6
    page.gui[base, "on"].becomes(False)
    for name in (base, limbus):
        page.gui[name, "colour"].becomes((1, 160, 255))
    page.gui[limbus, "opacity"].becomes(0.25)
    lower, upper = (base, False, "#01a0ff", 1.0, 0.0), (limbus, True, "#01a0ff", 0.25, 0.2)
    assert page.asked["layers"] == (lower, upper)
    page.gui[base, "back to the mixture"].becomes(True)
    assert page.asked["layers"] == ((base, False, None, 1.0, 0.0), upper)
    assert page.gui[base, "colour"].value == mixed


def test_the_uppermost_coat_stands_first_wherever_it_came_from(page):
    folders = page.panel.folders

    def shown():
        return sorted(folders, key=lambda name: folders[name].order)

    assert shown() == ["02 limbus", "01 base"]
    page.gui["01 base", "place"].becomes("up")
    assert shown() == ["01 base", "02 limbus"]
    heights = [(x.name, x.height) for x in page.asked["layers"]]
    assert heights == [("02 limbus", 0.0), ("01 base", 0.2)]
    page.gui["01 base", "place"].becomes("up")
    assert shown() == ["01 base", "02 limbus"]


def test_saves_what_is_asked_for_and_says_where(page):
    page.gui["01 base", "on"].becomes(False)
    page.gui["", "save the recipe"].becomes(True)
    assert str(page.folder / "recipe.toml") in page.panel.saved.content
    assert "base" not in (page.folder / "recipe.toml").read_text().split("[[coat]]")[1]
    page.gui["02 limbus", "on"].becomes(False)
    page.gui["", "save the recipe"].becomes(True)
    assert "no coat is on" in page.panel.saved.content


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--type", "detail"), "--type and --colour go together"),
        (("--type", "detail", "--colour", "violet"), "violet"),
        (("--recipe", "a.toml", "--type", "detail", "--colour", "blue"), "one of them"),
        (("--preset", "blue", "--type", "detail", "--colour", "blue"), "give one eye"),
        (("scene.toml", "--recipe", "a.toml"), "give one eye"),
        (("--pupil-radius", "2"), "--pupil-radius is of a painted eye"),
        (("--mixing", "hsl"), "--mixing is of a painted eye"),
        (("--recipe", "nowhere.toml"), "nowhere.toml"),
    ],
)
def test_refuses_eyes_that_do_not_go_together(viser, complaint, arguments, words):
    assert words in complaint(*arguments)


def test_names_the_recipe_whose_coat_cannot_be_painted(viser, complaint, tmp_path):
    path = tmp_path / "wrong.toml"
    path.write_text('[[coat]]\ncomponent = "base"\npaints = ["burnt amber"]\n')
    said = complaint("--recipe", path)
    assert str(path) in said and "coat 1 (base)" in said and "burnt amber" in said
