"""How far the model's numbers are trusted, which way a centre of mass may err, and what belongs to another machine."""

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from s2r_host.gap.motion.two_masses import Gear, deflection
from s2r_host.gap.regression.base_terms import PREFIX, CentreDistance, base_terms, with_directions_held
from s2r_host.gap.regression.nuisance import BaseParameter
from s2r_host.gap.regression.solution import Scored, Term
from s2r_host.gap.search import trust
from s2r_host.gap.verdict.other_machine import other_machine


def number(name, nominal, column):
    return BaseParameter(name, "link", False, nominal, 0.5, "m", 0.03, lambda s: column, lambda spec, x: None)


def centre(x, z):
    return [number("com_x", x, np.array([1.0, 0.0])), number("com_z", z, np.array([0.0, 1.0]))]


def test_a_centre_of_mass_that_is_off_keeps_its_direction():
    held = with_directions_held(base_terms(centre(0.3, 0.4)))[f"{PREFIX}com@link"]
    assert isinstance(held, CentreDistance)
    (column,) = held.columns(None, None, -1, {}).linear  # pyright: ignore[reportArgumentType]
    assert column == pytest.approx([0.6, 0.8])
    moved = held.parameters(None, -1, {}, np.array([0.1]))  # pyright: ignore[reportArgumentType]
    assert moved["com_x"].value / moved["com_z"].value == pytest.approx(0.3 / 0.4)
    assert held.moves(np.array([0.1])) == pytest.approx([0.06, 0.08])


def test_a_centre_at_the_origin_has_no_direction_to_keep():
    free = with_directions_held(base_terms(centre(0.0, 1e-4)))[f"{PREFIX}com@link"]
    assert not isinstance(free, CentreDistance)


class Searched:
    """Answers one explanation with wide and one with narrow trust in the numbers; counts the searches."""

    def __init__(self, moved):
        self.looseness, self.completed, self.asked = 0.0, 0, []
        self.problem = SimpleNamespace(
            base=[SimpleNamespace(name="mass"), SimpleNamespace(name="timing")], prior=np.array([0.03, 0.5])
        )
        self.moved = moved

    def run(self, look=False):
        self.asked.append(self.looseness)
        names = (
            ("asymmetric_friction",) if self.looseness == trust.WIDE else ("coulomb_friction", "cable_spring")
        )
        terms = [Term(n, 0) for n in names]
        return SimpleNamespace(terms=terms, base=np.array([self.moved * 0.03, 2.0]), noise=3.0)

    def log(self, said):
        del said


@pytest.mark.parametrize(
    ("lead", "looseness"),
    [(30.0, trust.NARROW), (0.0, trust.NARROW), (-3.0, trust.WIDE), (-30.0, trust.WIDE)],
)
def test_the_evidence_says_how_far_numbers_are_trusted(monkeypatch, lead, looseness):
    search = Searched(moved=-2.0)
    monkeypatch.setattr(trust, "stretched", lambda problem, solution: None)
    monkeypatch.setattr(trust, "worth", lambda s, x, loose, noise: lead if loose == trust.NARROW else 0.0)
    found, solution = trust.search_under_both(search, look=False)  # pyright: ignore[reportArgumentType]
    assert found == looseness == search.looseness
    assert len(solution.terms) == (2 if looseness == trust.NARROW else 1)


@pytest.mark.parametrize(("far", "looseness"), [(trust.WIDE, trust.NARROW), (None, trust.WIDE)])
def test_an_explanation_by_a_machine_that_cannot_be_loses_to_one_without(monkeypatch, far, looseness):
    """However much it fits better, and without staying a rival."""
    search, rivals = Searched(moved=-2.0), []

    def stretched(problem, solution):
        wide = solution.terms[0].effect == "asymmetric_friction"
        return "far off" if wide and far is not None else None

    monkeypatch.setattr(trust, "stretched", stretched)
    monkeypatch.setattr(trust, "_stays_rival", lambda *x: rivals.append(x))
    monkeypatch.setattr(trust, "worth", lambda s, x, loose, noise: -8639.0 if loose == trust.NARROW else 0.0)
    found, _ = trust.search_under_both(search, look=False)  # pyright: ignore[reportArgumentType]
    assert found == looseness == search.looseness
    assert len(rivals) == (0 if far is not None else 1)


@pytest.mark.parametrize("beaten_by", [3.0, 12.0])
def test_what_the_other_trust_names_in_one_place_stays_a_rival(beaten_by):
    """A cable with the numbers as they are, against a loop beside a mass that moved."""

    def explanation(first, *more):
        terms = [Term(n, 0) for n in (first, *more)]
        slot = [
            Scored(t, g, g, 0.5, np.zeros(0)) for t, g in ((terms[0], 34.0), (Term("presliding", 0), 20.0))
        ]
        return SimpleNamespace(terms=terms, slots=[slot, [], []][: len(terms)])

    best, other = explanation("cable_spring", "cogging"), explanation("hysteresis", "cogging")
    trust._stays_rival(best, other, beaten_by)  # pyright: ignore[reportArgumentType]
    weighed = [(s.term.effect, s.gain) for s in best.slots[0]]
    assert weighed == [("cable_spring", 34.0), ("hysteresis", 34.0 - beaten_by), ("presliding", 20.0)]
    elsewhere = explanation("hysteresis", "detent")  # two terms differ: no single place is shared
    trust._stays_rival(best, elsewhere, 1.0)  # pyright: ignore[reportArgumentType]
    assert [(s.term.effect, s.gain) for s in best.slots[0]] == weighed


def test_where_no_number_moved_nothing_hides_in_them():
    search = Searched(moved=0.3)  # the timing moved, but is of the comparison and not of the machine
    assert trust.search_under_both(search, look=False)[0] == trust.WIDE  # pyright: ignore[reportArgumentType]
    assert search.asked == [trust.WIDE]


def test_behind_a_spring_gravity_pulls_where_the_link_is():
    rows, load, slope, k = 4000, 5.0, 40.0, 400.0
    held = deflection(
        0.001,
        np.full(rows, 0.1),
        np.full(rows, load),
        np.full(rows, slope),
        np.zeros(rows),
        Gear(0.1, k, 5.0),
    )
    # Sagged by x, the link weighs load - slope x and the spring holds k x.
    assert held[-1] == pytest.approx(k * load / (k + slope), rel=1e-3)


LINK = """<mujoco><worldbody><body name="link"><joint name="joint" axis="0 1 0"/>
  <inertial mass="4" pos="0.3 0 0" diaginertia="0.01 0.01 0.01"/></body></worldbody></mujoco>"""


@pytest.mark.parametrize(("to", "effects", "other"), [(0.8, 1, True), (3.6, 1, False), (0.8, 0, False)])
def test_a_mass_far_off_beside_an_effect_is_another_machine(to, effects, other):
    model = SimpleNamespace(
        model=mujoco.MjModel.from_xml_string(LINK), joints=["joint"], jointed_bodies=lambda: [1],
        body_name=lambda body: "link",
    )  # fmt: skip
    mass = {"name": "mass", "body": "link", "from": 4.0, "to": to}
    decision = SimpleNamespace(parameters_off=[mass], effects=[SimpleNamespace(name="cogging")] * effects)
    said = other_machine(SimpleNamespace(ctx=SimpleNamespace(model=model)), decision)  # pyright: ignore[reportArgumentType]
    assert (said is not None) == other


class Hiding:
    """Numbers that moved by so many deviations, and what leads the catalogue where they are held narrowly."""

    def __init__(self, moved, best, gain=50.0):
        self.looseness = trust.WIDE
        self.problem = SimpleNamespace(
            base=[SimpleNamespace(name="mass")],
            prior=np.array([0.03]),
            prior_at=lambda looseness: looseness * np.array([0.03]),
            joints=[0],
            ctx=None,
        )
        self.moved, self.best, self.gain, self.scanned = moved, best, gain, []

    def finish(self, *_):
        return SimpleNamespace(base=np.array([self.moved * 0.03]))

    def scan_profiled(self, _):
        self.scanned.append(self.looseness)
        return [SimpleNamespace(term=Term(self.best, 0), gain=self.gain)], 3.0

    def a_number(self, term):
        return term.effect.startswith(PREFIX)

    def clear(self, best, slots):
        return best.gain > trust.CLEAR_GAIN

    def predict(self, terms, noise):
        return 0.0, {}


@pytest.mark.parametrize(
    ("moved", "best", "cost", "hidden"),
    [
        (1.5, "spring_return", 10.0, True),
        (1.5, "spring_return", 45.0, False),
        (1.5, f"{PREFIX}mass@link", 10.0, False),
        (0.3, "spring_return", 10.0, False),
    ],
)
def test_numbers_that_moved_far_hide_an_effect_that_is_worth_more(monkeypatch, moved, best, cost, hidden):
    """Held narrowly the numbers explain ``cost`` log odds less; the effect has to win back more than that."""
    monkeypatch.setattr(
        trust, "evidence", lambda search, *_: -cost if search.looseness == trust.NARROW else 0.0
    )
    search = Hiding(moved, best)
    assert trust.hides(search) is hidden  # pyright: ignore[reportArgumentType]
    assert search.looseness == trust.WIDE
    assert search.scanned == ([trust.NARROW] if moved > trust.MOVED else [])
