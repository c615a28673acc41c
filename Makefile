# Two commands on a fresh machine: `make demo` and `make test`. Each does all its set-up.
SEED ?= 1

.PHONY: demo test test-learn prove check build docs lock generate clean

demo:   ## open a never-seen drawer end to end on the stand-in
	scripts/bootstrap demo
	.venv/bin/s2r demo --seed $(SEED)

test:   ## set up everything, then run what CI runs
	scripts/bootstrap test
	scripts/check

test-learn: ## the tests of training: they need PyTorch, some gigabytes that `make test` does without
	scripts/bootstrap test
	.venv/bin/uv pip install --quiet --python .venv/bin/python --requirements pyproject.toml --extra learn
	.venv/bin/python -m pytest -q -n 2 --dist loadfile $$(grep -rl --include='test_*.py' "extra 'learn'" tests)

prove:  ## every fault, every long proof (table into docs/safety.md), the executor on a kernel CAN bus
	scripts/bootstrap test
	scripts/prove
	scripts/prove-socketcan

check:  ## what CI runs, without the set-up
	scripts/check

build:  ## rebuild the native parts after a C++ edit
	scripts/bootstrap --rebuild test

docs:   ## build the documentation site into build/site/; it opens without a network
	scripts/bootstrap test
	.venv/bin/python scripts/generate-reference
	.venv/bin/mkdocs build --quiet

lock:   ## refresh locks/ from pyproject.toml
	scripts/lock

generate: ## refresh committed generated files
	scripts/generate

clean:
	rm -rf .venv build runs
