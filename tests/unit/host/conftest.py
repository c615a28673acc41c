"""A joint that swings, as a recording with slow noise and something hidden in its effort."""

import numpy as np
import pytest
from scipy.signal import lfilter

from s2r_host.gap.motion.session import make_session
from s2r_host.gap.recordings.recording import Controller, Recording

DT = 0.004


@pytest.fixture
def swung():
    """``swung(model, index, phase, hidden)`` with ``hidden(q, dq)`` the effort the model lacks [N·m]: a session."""

    def made(model, index, phase, hidden):
        rng = np.random.default_rng(index)
        t = np.arange(0, 20, DT)
        q = 0.6 * np.sin(1.7 * t + phase) + 0.2 * np.sin(5.3 * t + 2.0 * phase)
        dq = np.gradient(q, DT)
        noise = np.asarray(lfilter([0.2], [1.0, -0.9], rng.normal(size=len(t))))
        u = model.inverse(q[:, None], dq[:, None], np.gradient(dq, DT)[:, None])[:, 0]
        u = u + hidden(q, dq) + 0.02 * noise / np.std(noise)
        channels = {"q": {"elbow": q}, "dq": {"elbow": dq}, "tau": {"elbow": u}}
        rec = Recording(f"r{index}", t, channels, Controller("none"), "measured", "effort", "a", "", ())
        return make_session(model, rec, index)

    return made
