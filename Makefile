# make install, make demo, make test: each works from a fresh clone. PYTHON picks the interpreter.
PYTHON ?= python3
BIN := .venv/bin

.PHONY: install demo test slow clean

install: .venv/installed

.venv/installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --constraint constraints.txt --editable ".[agents,dev]"
	touch $@

demo: install
	$(BIN)/shake compare --scenario records --controllers none tvc lqg nmpc dagger-apg --num-noise-motions 0 \
		--report out/demo --force

test: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/pytest --numprocesses 2

slow: install
	$(BIN)/pytest -m slow

clean:
	rm -rf .venv build *.egg-info
