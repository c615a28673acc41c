"""Which piece of a faucet is pushed, and which way, follows its looks first and what pushes have shown then."""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from s2r_host.motion.levers import LeverCandidate
from s2r_host.motion.scene import Scene, observed_scene
from s2r_host.perception.affordance import Affordance, PushProposal
from s2r_host.perception.object_cloud import ObjectCloud
from s2r_host.perception.synthetic import faucet_view
from s2r_host.run.guess import ABOUT_M, Guess, Tried
from s2r_host.run.lever_guesses import GuessSettings, lever_guesses
from s2r_host.run.lever_looks import (
    IS_LEVER,
    SWINGS,
    SWINGS_BY_SHAPE,
    lever_features,
    odds_of,
    swing_features,
)

UP = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def view():
    """(scene, root and tip of the lever) of a faucet whose lever stands square to its spout."""
    seen = faucet_view(np.random.default_rng(0), np.pi / 2)
    return observed_scene(seen.frame), (seen.p_root, seen.p_tip)


def undecided(scene, part=0.5, proposals=()):
    """A network that believes the same of every point, without a line of motion."""
    p = scene.p_base[::4]
    shape = np.zeros((len(p), 1), np.float32)
    cloud = ObjectCloud(p, np.zeros_like(p), np.zeros(len(p), np.int64), p.mean(axis=0), shape)
    belief = np.full(len(p), part)
    line = np.tile(np.full(3, 3**-0.5), (len(p), 1))
    return Affordance(cloud, belief, belief, line, tuple(proposals))


def believing(scene, lever, near, elsewhere):
    """A network that believes so much of points near the lever, and so much of all others."""
    found = undecided(scene)
    at_lever = np.linalg.norm(found.cloud.points - np.mean(lever, axis=0), axis=1) < 0.07
    return replace(found, part=np.where(at_lever, near, elsewhere))


def piece(root, tip, rooted=False):
    """A straight piece of a faucet whose body stands at (0.6, 0)."""
    root, tip, body = np.array(root), np.array(tip), np.array([0.6, 0.0])
    p = root + np.linspace(0.0, 1.0, 50)[:, None] * (tip - root)
    level, out = (tip - root)[:2], root[:2] - body
    radial = abs(float(level @ out)) / max(1e-9, float(np.linalg.norm(level) * np.linalg.norm(out)))
    outward = np.append(tip[:2] - body, 0.0) / np.linalg.norm(tip[:2] - body)
    return LeverCandidate(p, root, tip, 0.02, 0.02, 0.0, outward, 0.1, radial, rooted, body)


def guesses(scene, tried=(), found=None):
    return lever_guesses(scene, found or undecided(scene), GuessSettings(), tried)


def first_push(ranked):
    return next(push for guess in ranked for push in guess.proposals)


def about_lever(push, lever):
    return np.linalg.norm(push.p_contact - np.mean(lever, axis=0)) < 0.08


def test_the_lever_is_pushed_level_and_across_before_anything_else(view):
    scene, lever = view
    push = first_push(guesses(scene))
    assert about_lever(push, lever)
    assert abs(push.direction @ (lever[1] - lever[0])) < 0.3 * np.linalg.norm(lever[1] - lever[0])
    assert abs(push.direction @ UP) < 0.05


def test_an_end_of_a_lever_that_held_out_is_never_pushed_the_same_way_again(view):
    scene, lever = view
    first = first_push(guesses(scene))
    ranked = guesses(scene, [Tried(first.p_contact, first.direction, held_out=True, moved=False)])
    again = [
        push
        for guess in ranked
        if guess.at_free_end(first.p_contact)
        for push in guess.proposals
        if about_lever(push, lever)
    ]
    assert again
    assert all(push.direction @ first.direction < 0.7 for push in again)


def test_a_lever_whose_tip_held_out_may_turn_about_its_tip(view):
    scene, _ = view
    first = first_push(guesses(scene))
    before, after = (
        next(
            guess.weight
            for guess in guesses(scene, tried)
            if guess.p_free is not None
            and about_lever(first, [guess.p_free, guess.p_held])
            and not guess.at_free_end(first.p_contact)
        )
        for tried in ([], [Tried(first.p_contact, first.direction, held_out=True, moved=False)])
    )
    assert after == before > 0.0


def test_a_lever_that_held_out_both_ways_falls_behind_the_spout(view):
    scene, lever = view
    found = believing(scene, lever, 0.65, 0.42)
    tried = []
    for _ in range(2):
        push = first_push(guesses(scene, tried, found))
        assert about_lever(push, lever)
        tried.append(Tried(push.p_contact, push.direction, held_out=True, moved=False))
    assert not about_lever(first_push(guesses(scene, tried, found)), lever)


def test_what_moved_a_little_is_pushed_again(view):
    scene, lever = view
    first = first_push(guesses(scene))
    spout = next(
        push
        for guess in guesses(scene)
        for push in islice(guess.proposals, 1)
        if not about_lever(push, lever)
    )
    moved = Tried(spout.p_contact, spout.direction, held_out=False, moved=True)
    held_out = Tried(first.p_contact, first.direction, held_out=True, moved=False)
    assert not about_lever(first_push(guesses(scene, [held_out, moved])), lever)


def test_a_push_that_passed_by_without_moving_anything_is_not_repeated_at_the_same_place(view):
    scene, _ = view
    first = first_push(guesses(scene))
    missed = Tried(first.p_contact, first.direction, held_out=False, moved=False)
    for guess in guesses(scene, [missed]):
        for push in guess.proposals:
            same_place = np.linalg.norm(push.p_contact - first.p_contact) < 0.025
            assert not (same_place and push.direction @ first.direction > 0.7)


def test_the_network_belief_decides_between_pieces_that_look_alike(view):
    scene, lever = view
    found = undecided(scene)
    trusted, doubted = believing(scene, lever, 0.95, 0.05), believing(scene, lever, 0.0, 1.0)

    def weight_of_lever(found):
        ranked = guesses(scene, found=found)
        own = sum(g.weight for g in ranked if about_lever(next(g.proposals), lever))
        return own / sum(g.weight for g in ranked)

    assert weight_of_lever(trusted) > weight_of_lever(found) > weight_of_lever(doubted)


def test_a_network_that_believes_in_the_wrong_piece_is_doubted_after_pushes_on_it(view):
    scene, lever = view
    misled = believing(scene, lever, 0.0, 1.0)
    tried = []
    while not about_lever(push := first_push(guesses(scene, tried, misled)), lever):
        tried.append(Tried(push.p_contact, push.direction, held_out=True, moved=False))
        assert len(tried) <= 4


def test_what_surely_gave_way_is_pushed_on_the_same_way_first(view):
    scene, lever = view
    first = first_push(guesses(scene))
    back = next(
        push
        for guess in guesses(scene)
        for push in guess.proposals
        if about_lever(push, lever) and push.direction @ first.direction < -0.9
    )
    again = first_push(guesses(scene, [Tried(back.p_contact, back.direction, False, moved=True, sure=True)]))
    assert about_lever(again, lever)
    assert again.direction @ back.direction > 0.7


def test_where_nothing_looks_like_a_lever_the_network_is_asked():
    rng = np.random.default_rng(1)
    angle, z = rng.uniform(0, 2 * np.pi, 4000), rng.uniform(0.0, 0.2, 4000)
    post = np.column_stack([0.6 + 0.02 * np.cos(angle), 0.02 * np.sin(angle), z])
    scene = Scene(post, np.array([0.0, -0.45, 0.55]))
    point, direction = np.array([0.58, 0.0, 0.19]), np.array([1.0, 0.0, 0.0])
    knob = PushProposal(point, -direction, direction, 0.9, 0.9)
    ranked = guesses(scene, found=undecided(scene, proposals=[knob]))
    assert len(ranked) == 1
    assert first_push(ranked).direction @ direction > 0.99
    assert guesses(scene, found=undecided(scene)) == []


def odds(levers, k):
    """Logit of the k-th piece being the lever, all believed in alike."""
    return float(np.dot(IS_LEVER, lever_features(levers, k, [0.6] * len(levers))))


def test_a_piece_from_whose_end_another_leads_down_is_a_spout():
    rising = piece((0.55, 0.0, 0.2), (0.45, 0.0, 0.25))
    falling = piece((0.44, 0.0, 0.25), (0.4, 0.0, 0.15))
    straight_on = piece((0.44, 0.0, 0.255), (0.36, 0.0, 0.295))
    assert odds([rising, falling], 0) < odds([rising, straight_on], 0) - 1.5


def test_what_hangs_on_the_body_between_two_handles_with_feet_of_their_own_is_a_spout():
    between = piece((0.55, 0.0, 0.1), (0.45, 0.0, 0.12))
    handle = piece((0.6, 0.15, 0.1), (0.5, 0.15, 0.12), rooted=True)
    assert odds([between, handle], 0) < odds([between, replace(handle, rooted=False)], 0)


def test_of_two_handles_alike_one_is_as_likely_as_the_other():
    one = piece((0.6, 0.15, 0.1), (0.5, 0.15, 0.12), rooted=True)
    other = piece((0.6, -0.15, 0.1), (0.66, -0.07, 0.12), rooted=True)
    spout = piece((0.55, 0.0, 0.1), (0.45, 0.0, 0.12))
    shares = odds_of([one, other, spout], [0.2, 0.8, 0.5])
    assert shares[0] == pytest.approx(shares[1])
    assert (shares[0] > shares[2]).all()
    for unlike in (
        replace(other, rooted=False),
        piece((0.6, -0.15, 0.1), (0.63, -0.11, 0.12), rooted=True),  # half as long
        piece((0.6, -0.15, 0.1), (0.66, -0.07, 0.17), rooted=True),  # rises more
    ):
        apart = odds_of([one, unlike, spout], [0.2, 0.8, 0.5])
        assert apart[0, 0] < 0.5 * apart[1, 0]


def test_a_level_lever_beside_the_body_swings_and_one_that_leads_away_from_it_does_not():
    no_line = np.full(3, 3**-0.5)
    beside = piece((0.6, 0.05, 0.2), (0.5, 0.05, 0.21))
    on_top = piece((0.56, 0.0, 0.2), (0.46, 0.0, 0.21))
    for logits in (SWINGS, SWINGS_BY_SHAPE):
        swings = np.dot(logits, swing_features(beside, no_line))
        assert swings > -1.0  # a level one may as well turn
        assert np.dot(logits, swing_features(on_top, no_line)) < swings - 5.0


def test_what_only_the_network_sees_is_turned_about_the_body_before_it_is_pushed_as_the_network_says():
    """What the spout half hides is no straight piece, and the network's line of its motion is far off there."""
    rng = np.random.default_rng(1)
    angle, z = rng.uniform(0, 2 * np.pi, 4000), rng.uniform(0.0, 0.2, 4000)
    post = np.column_stack([0.6 + 0.02 * np.cos(angle), 0.02 * np.sin(angle), z])
    lump = np.array([0.58, 0.06, 0.19]) + rng.uniform(-0.014, 0.014, (1500, 3))
    scene = Scene(np.concatenate([post, lump]), np.array([0.0, -0.45, 0.55]))
    found = undecided(scene)
    slanted = PushProposal(lump[0], np.array([0.0, 1.0, 0.0]), np.array([0.6, 0.0, -0.8]), 0.9, 0.9)
    on_lump = np.linalg.norm(found.cloud.points - lump.mean(axis=0), axis=1) < 0.04
    found = replace(found, part=np.where(on_lump, 0.9, 0.0), proposals=(slanted,))
    first, second = (guess for guess in guesses(scene, found=found) if guess.by_shape == 0.0)
    assert first.weight > second.weight
    assert first.p_held is not None
    assert abs(first.line @ UP) < 1e-9
    out = np.array([-0.02, 0.06, 0.0]) / np.hypot(0.02, 0.06)
    assert abs(first.line @ out) < 0.3
    assert second.line @ slanted.direction > 0.99


def test_a_bare_hub_on_the_deck_has_a_lever_that_points_at_the_camera():
    """Seen from its end a lever is no straight piece; two draws of `s2r bench paper` were never pushed at theirs."""
    rng = np.random.default_rng(1)
    deck = np.column_stack([rng.uniform([0.5, -0.16], [0.7, 0.16], (6000, 2)), np.full(6000, 0.02)])
    angle, z = rng.uniform(0, 2 * np.pi, 3000), rng.uniform(0.02, 0.18, 3000)
    post = np.column_stack([0.6 + 0.02 * np.cos(angle), 0.02 * np.sin(angle), z])
    hub = np.array([0.6, -0.12, 0.0]) + rng.uniform([-0.014, -0.014, 0.02], [0.014, 0.014, 0.05], (800, 3))
    camera = np.array([0.0, -0.45, 0.55])
    scene = Scene(np.concatenate([deck, post, hub]), camera)

    def on_hub(*tried: Tried) -> list[Guess]:
        return [
            guess
            for guess in guesses(scene, tried)
            if guess.p_held is not None and np.linalg.norm(guess.p_held[:2] - [0.6, -0.12]) < 0.01
        ]

    found = on_hub()
    assert found
    towards = (camera - found[0].p_held)[:2] / np.linalg.norm((camera - found[0].p_held)[:2])
    assert (found[0].p_free - found[0].p_held)[:2] @ towards > 0.05
    assert abs(found[0].line[:2] @ towards) < 0.05
    push = next(found[0].proposals)
    assert 0.02 < np.linalg.norm(push.p_contact[:2] - found[0].p_held[:2]) < 0.08
    # What met nothing, or something that held out, where the lever is felt for tells against it.
    push = next(p for p in found[0].proposals if np.linalg.norm(hub - p.p_contact, axis=1).min() > ABOUT_M)
    held = on_hub(Tried(push.p_contact, push.direction, held_out=True, moved=False))[0]
    assert held.weight < 0.3 * found[0].weight
    assert next(held.proposals).direction @ push.direction < 0.0


def test_where_nothing_stands_above_the_deck_there_is_no_body_to_turn_about():
    flat = np.random.default_rng(1).uniform([0.5, -0.1, 0.001], [0.7, 0.1, 0.012], (4000, 3))
    assert guesses(Scene(flat, np.array([0.0, -0.45, 0.55]))) == []
