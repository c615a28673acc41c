"""What the pair network's belief is worth beside geometry: fits `network_belief.Trust` on validation pairs.

    python tests/bench/bench_pair_belief.py --first 1100 --count 24 --weights runs/model --out runs/pair-belief

Each pair is searched by geometry; every refined candidate gets a row with its cost, its distance from the network's
votes in units of what the network expects, and whether it is right: the part's corners, moved on from the second view
by 0.10 m or 45 degrees, come within 25 mm of where the true joint takes them. The trust is that of the greatest
likelihood of the right candidates, cost and belief together, with a pull towards none. Written into the weights'
about.json. Rows are kept as JSON lines; an interrupted run goes on.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from bench_perception import frames, runtime, transport_mm, true_motion, weights_hash
from refusals import told_by
from scipy.optimize import minimize

from s2r_host.perception import AbstainError, BadViewError
from s2r_host.perception.estimate import Search, look_for_motion, prepare
from s2r_host.perception.evidence import Scene
from s2r_host.perception.network_belief import Trust
from s2r_host.perception.pair_network import ABOUT, PairNetworkRuntime
from s2r_host.perception.ranking import EVIDENCE_SCALE
from s2r_sim.batch import run_jobs
from s2r_sim.objects.pairs import Pair, draw_pair
from s2r_sim.objects.splits import Split

RIGHT_MM = 25.0
NAMES = ("family", "direction", "line", "state", "flow", "size")
START = np.log([0.5, 0.3, 0.3, 0.3, 0.3, 1.5])
PULL = 0.1  # nats per pair of a weight that is e times what it starts at


def measure(weights: str, kind: str, seed: int) -> dict[str, Any]:
    """Candidates of one pair."""
    pair, rng = draw_pair(kind, Split.VALIDATION, seed), np.random.default_rng(0)
    row: dict[str, Any] = {"kind": kind, "seed": seed}
    try:
        first, _ = prepare(*frames(pair), None, None, None, rng)
        _, found = look_for_motion(first, rng)
    except (AbstainError, BadViewError) as error:
        return row | {"abstained": str(error)}
    return row | candidates(first, found, pair, runtime(weights))


def candidates(first: Scene, found: Search, pair: Pair, network: PairNetworkRuntime) -> dict[str, Any]:
    """Cost, distance from the network's votes, and transport error of each candidate."""
    belief = network.belief(first, np.random.default_rng([0, 1]))
    if belief is None:
        return {"silent": True}
    truth = true_motion(pair)
    return {
        "cost": [h.cost for h in found.ranked],
        "family": [belief.family(h.motion) for h in found.ranked],
        "errors": [belief.errors(h.motion).tolist() for h in found.ranked],
        "wrong_mm": [
            transport_mm(h.motion, truth, pair) if h.motion.joint_type == truth.joint_type else 1e3
            for h in found.ranked
        ],
    }


def fit(rows: Sequence[dict[str, Any]], most_nats: float = 4.0) -> tuple[Trust, float, float]:
    """The trust of greatest likelihood, and the mean log-likelihood of right candidates without and with it [nats]."""
    usable = []
    for row in rows:
        right = np.array(row.get("wrong_mm", [])) < RIGHT_MM
        if right.any() and not right.all():
            cost = -np.array(row["cost"]) / EVIDENCE_SCALE
            usable.append((cost, np.array(row["family"]), np.array(row["errors"]), right))

    def likelihood(trust: Trust | None) -> float:
        total = 0.0
        for cost, family, errors, right in usable:
            nats = (
                0.0
                if trust is None
                else np.array([trust.nats(f, e) for f, e in zip(family, errors, strict=True)])
            )
            value = cost + nats
            total += float(np.logaddexp.reduce(value[right]) - np.logaddexp.reduce(value))
        return total / max(len(usable), 1)

    def loss(x: np.ndarray) -> float:
        pull = PULL * float((x - START) @ (x - START)) / max(len(usable), 1)
        return pull - likelihood(made(x, most_nats))

    x = minimize(loss, START, method="Nelder-Mead", options={"maxfev": 1500, "xatol": 0.02, "fatol": 1e-4}).x
    trust = made(x, most_nats)
    return trust, likelihood(None), likelihood(trust)


def made(x: np.ndarray, most_nats: float) -> Trust:
    """From logarithms in the order of `NAMES`."""
    return Trust(
        most_nats=most_nats, **{n: round(float(np.exp(v)), 4) for n, v in zip(NAMES, x, strict=True)}
    )


def main() -> None:
    """Run, fit, write."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kinds", default="laptop,faucet", help="comma-separated")
    parser.add_argument("--first", type=int, default=1100, help="first validation seed")
    parser.add_argument("--count", type=int, default=24, help="pairs per kind")
    parser.add_argument("--weights", type=Path, required=True, help="folder of a trained pair network")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--out", type=Path, required=True, help="folder of the rows")
    args = parser.parse_args()
    jobs = [
        (kind, seed) for seed in range(args.first, args.first + args.count) for kind in args.kinds.split(",")
    ]
    work, conditions = partial(measure, str(args.weights)), {"--weights": weights_hash(args.weights)}
    with told_by(parser):
        rows = run_jobs(work, jobs, args.out / "rows.jsonl", args.jobs, "pairs", conditions=conditions)
    trust, without, with_it = fit(rows)
    about = json.loads((args.weights / ABOUT).read_text())
    about["trust"] = vars(trust)
    about["trust_from"] = f"validation {args.first} to {args.first + args.count - 1} of {args.kinds}"
    (args.weights / ABOUT).write_text(json.dumps(about, indent=1) + "\n")
    print(f"{trust}\nlog-likelihood of right candidates: {without:.3f} without, {with_it:.3f} with it")


if __name__ == "__main__":
    main()
