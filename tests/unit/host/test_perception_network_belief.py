"""A network's belief among the hypotheses of geometry."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from s2r_host.perception import estimate_joint, synthetic
from s2r_host.perception.estimate import KNOWN_TO_BOTH, Search, prepare, sure_enough
from s2r_host.perception.motion import JointMotion
from s2r_host.perception.network_belief import Trust, weighed_by
from s2r_host.perception.pair_belief import LEAST_PROBABILITY, PairBelief
from s2r_host.perception.pair_network import WEIGHTS, PairNetworkRuntime
from s2r_host.perception.pair_votes import (
    FLOW,
    PART,
    SLIDES,
    SPREAD_DIRECTION,
    SPREAD_FLOW,
    Votes,
    true_votes,
)
from s2r_host.perception.ranking import EVIDENCE_SCALE, Hypothesis
from s2r_host.perception.refine import Refined

TURN = JointMotion("revolute", np.array([0.4, 0.1, 0.2]), np.array([0.0, 0.6, 0.8]), 0.7)
SLIDE = JointMotion("prismatic", np.array([0.4, 0.1, 0.2]), np.array([0.6, 0.0, -0.8]), 0.12)


TRUST = Trust()


def _belief(motion, trust=TRUST, slides=4.0, expected=0.1):
    """Of a network whose votes are right up to what it expects."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.1, 0.3, (400, 3))
    output = true_votes(points, motion).astype(float)
    output[:, PART] = 3.0
    output[:, SLIDES] = slides if motion.joint_type == "prismatic" else -slides
    output[:, SPREAD_DIRECTION : SPREAD_FLOW + 1] = np.log(expected)
    output[:, FLOW] += rng.normal(size=(400, 3)) * 0.02
    votes = Votes(points, output, np.zeros(400, bool))
    opinion = votes.opinion()
    assert opinion is not None
    return PairBelief(opinion, votes, trust)


@pytest.mark.parametrize("motion", [TURN, SLIDE], ids=["turn", "slide"])
def test_what_the_network_votes_for_costs_nothing_and_its_reverse_the_most(motion):
    belief = _belief(motion, Trust(most_nats=3.0))
    assert belief.nats(motion) > -0.2
    assert belief.nats(replace(motion, direction=-motion.direction)) == -3.0
    near = replace(motion, delta=motion.delta * 1.1)
    assert -3.0 < belief.nats(near) < belief.nats(motion)


def test_a_hinge_aside_costs_by_what_the_network_expects_of_its_own_line():
    aside = replace(TURN, origin=TURN.origin + np.array([0.02, 0.0, 0.0]))
    sure, unsure = _belief(TURN, expected=0.1), _belief(TURN, expected=0.6)
    assert sure.nats(aside) < unsure.nats(aside) - 0.5


def test_the_other_family_costs_no_more_than_the_network_is_ever_sure_of():
    trust = Trust(family=1.0, direction=0, line=0, state=0, flow=0, most_nats=50)
    belief = _belief(SLIDE, trust, slides=30.0)
    assert belief.nats(TURN) == pytest.approx(np.log(LEAST_PROBABILITY / (1 - LEAST_PROBABILITY)))
    assert belief.nats(SLIDE) == 0.0


def _hypothesis(motion, cost):
    refined = Refined.__new__(Refined)
    return Hypothesis(motion, cost, cost, 0.0, refined)


def test_belief_turns_the_order_of_what_evidence_can_hardly_tell_apart():
    reverse = replace(TURN, direction=-TURN.direction)
    near = [_hypothesis(reverse, 0.100), _hypothesis(TURN, 0.110)]
    ranked = weighed_by(_belief(TURN), near)
    assert ranked[0].motion is TURN
    assert ranked[0].weight > 0.9
    assert sum(h.weight for h in ranked) == pytest.approx(1.0)


def test_clear_evidence_stands_against_any_belief():
    reverse = replace(TURN, direction=-TURN.direction)
    trust = Trust(most_nats=4.0)
    far = [_hypothesis(reverse, 0.1), _hypothesis(TURN, 0.1 + 5 * EVIDENCE_SCALE)]
    assert weighed_by(_belief(TURN, trust), far)[0].motion is reverse
    assert weighed_by(_belief(TURN), []) == []


@dataclass
class Says:
    """A network that believes in one motion."""

    motion: JointMotion
    asked: int = 0

    def belief(self, scene, rng):
        self.asked += 1
        return _belief(self.motion)


def test_estimate_asks_the_network_and_finds_what_both_agree_on():
    pair = synthetic.laptop_pair(np.random.default_rng(3), turn_rad=0.6)
    network = Says(pair.motion.positive())
    found = estimate_joint(pair.before, pair.after, network=network)
    assert network.asked == 1
    assert found.joint_type == "revolute"
    assert found.axis_direction @ pair.motion.positive().direction > np.cos(np.radians(3))
    assert found.hypotheses[0].cost <= min(h.cost for h in found.hypotheses)


def test_a_vague_turn_is_sure_enough_only_where_the_network_agrees():
    reverse = replace(TURN, direction=-TURN.direction)
    agreed, against = (Search([_hypothesis(m, 0.1)], [], None) for m in (TURN, reverse))  # type: ignore[arg-type]
    assert sure_enough(0.1, agreed, _belief(TURN)) == KNOWN_TO_BOTH > 0.1
    assert sure_enough(0.1, against, _belief(TURN)) == 0.1
    assert sure_enough(0.5, agreed, _belief(TURN)) == 0.5
    assert sure_enough(0.1, Search([], [], None), _belief(TURN)) == 0.1  # type: ignore[arg-type]


def test_the_shipped_network_knows_a_lid_it_never_saw():
    folder = WEIGHTS
    assert sum(file.stat().st_size for file in folder.iterdir()) < 6e6
    network = PairNetworkRuntime()
    assert len(network.about["data_sha256"]) == 64
    assert network.about["onnx_difference"] < 1e-4
    pair = synthetic.laptop_pair(np.random.default_rng(3), turn_rad=0.6)
    scene, _ = prepare(pair.before, pair.after, None, None, None, np.random.default_rng(0))
    belief = network.belief(scene, np.random.default_rng(0))
    assert belief is not None
    best, truth = belief.opinion.best(), pair.motion.positive()
    assert best.joint_type == "revolute"
    assert best.direction @ truth.direction > np.cos(np.radians(20))
    assert belief.nats(truth) > belief.nats(replace(truth, direction=-truth.direction)) + 0.5


def test_shipped_graphs_compute_what_the_shipped_weights_do():
    torch = pytest.importorskip("torch", reason="needs the extra 'learn'")
    pytest.importorskip("onnx", reason="needs the extra 'learn'")
    from safetensors.torch import load_file

    from s2r_host.learn.export import MOST_DIFFERENCE, PAIR, example_pair, graph_difference
    from s2r_host.learn.pair_network import PairNetwork

    network = PairNetwork().eval()
    network.load_state_dict(load_file(WEIGHTS / "weights.safetensors"))
    inputs = example_pair(torch.Generator().manual_seed(7))
    assert graph_difference(network, inputs, WEIGHTS / PAIR) < MOST_DIFFERENCE
