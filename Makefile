# The few things one does here. Everything runs in .venv, which the first target that needs it creates. The demo needs a third of the
# packages that the tests need, so there are stamp files: what reconstruction needs, what the tests need, and torch for test-all.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/$(if $(filter Windows_NT,$(OS)),Scripts,bin)
RECON := $(VENV)/.recon
SETUP := $(VENV)/.dev
DOCS := $(VENV)/.docs
ORACLES := $(VENV)/.oracles
MODELS := $(VENV)/.models
NPM := $(shell command -v npm 2>/dev/null)

MINUTES ?= 8

.PHONY: demo film sample test test-browser test-all check bench gpu player golden screens docs wheel npm-package setup models clean

demo: $(RECON)  ## reconstruct, compress, evaluate and play the built-in scene; a finished reel of it plays at once
	$(BIN)/splatreel demo --out out/demo

# The tests of `make test` answer in minutes. The others take long, kill processes, start a cluster or a browser, or build the wheel.
LONG := slow or kill or cluster or wheel or browser or oracle
WORKERS ?= auto
COVERAGE ?=
# RETRY=1, as .ci/run sets it, runs tests that failed once more, one at a time: a browser on a busy machine may be late. It says so.
RETRY ?=
PYTHON_RUN = $(BIN)/python -m $(if $(COVERAGE),coverage run -m )
# $(call pytest,MARKS): exit status 1 means that tests failed, and not that they could not run.
define pytest
$(PYTHON_RUN)pytest -n $(WORKERS) --maxprocesses 8 --durations=15 -m $(1) $(if $(RETRY),|| { test $$? = 1 && \
	echo 'FLAKY? The tests that failed run once more:' && \
	$(PYTHON_RUN)pytest --verbose --last-failed --last-failed-no-failures none -m $(1); })
endef

test: $(SETUP) $(if $(NPM),player/node_modules/.package-lock.json)  ## the tests that answer in minutes, on all cores
	$(if $(COVERAGE),$(BIN)/coverage erase)
	$(call pytest,'smoke or not ($(LONG))')

test-browser: $(SETUP)  ## the web player in a real browser, and the wheel; .ci/run runs them after the others
	$(call pytest,'(browser or wheel) and not (slow or kill or cluster or oracle or smoke)')

test-all: COVERAGE = 1
test-all: $(ORACLES) test  ## those, then all others, and how much of the code they ran
	$(call pytest,'($(LONG)) and not smoke')
	$(BIN)/coverage combine --quiet 2>out/coverage/combine.log || { cat out/coverage/combine.log; exit 1; }
	rm -f out/coverage/data.*  # cut off: of processes that were killed
	$(BIN)/coverage json --quiet -o out/coverage.json
	@echo "Python coverage: $$($(BIN)/coverage report --format=total) % of the statements; out/coverage.json lists the others."
	@$(if $(NPM),node -p 'JSON.parse(require("fs").readFileSync("player/out/tests.json")).coverage.line')

check: $(SETUP)  ## style, types, the import ladder and the sizes; that the committed player is the one its source builds
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright --pythonpath $(BIN)/python
	$(BIN)/python -m pytest -q tests/test_house.py tests/test_typescript.py
ifeq ($(NPM),)
	@echo "check: npm is not installed, so the types of the web player were NOT checked and its bundle NOT compared with its source."
else
	$(MAKE) player/node_modules/.package-lock.json
	npm --prefix player run typecheck
	npm --prefix player run lint
	npm --prefix player run format-check
	npm --prefix player run check
endif

bench: $(RECON)  ## append to benchmarks/results.jsonl
	$(BIN)/python benchmarks/demo.py
	$(BIN)/python benchmarks/measure.py kernels
	$(BIN)/python benchmarks/measure.py codec

gpu: $(SETUP)  ## on a machine with a GPU: test and measure there, within MINUTES; BASKETBALL=FOLDER, of Panoptic Sports
	$(BIN)/python benchmarks/gpu.py --minutes $(MINUTES) $(if $(BASKETBALL),--basketball '$(BASKETBALL)')

film: $(RECON)  ## film the built-in capture again for the package, after a change of its scene
	rm -rf out/film
	$(BIN)/python benchmarks/film_toyroom.py out/film
	rm -rf src/splatreel/capture/film
	mv out/film src/splatreel/capture/film

sample: $(RECON)  ## reconstruct the sample reel of the package again; after an interruption, the same command continues
	$(BIN)/splatreel demo --out out/sample --no-serve
	rm -rf src/splatreel/play/sample
	cp -R out/sample/reel src/splatreel/play/sample
	rm -rf out/sample

player: player/node_modules/.package-lock.json  ## rebuild the web player's bundle in src/splatreel/play/static
	npm --prefix player run build

golden: $(SETUP) screens  ## write the golden reels and the player's screenshots anew, on purpose: look at what changed
	$(BIN)/python -m tests.golden

screens: $(SETUP)  ## take the player's golden screenshots anew
	$(BIN)/python -m tests.player.screens

docs: $(DOCS)  ## build the documentation into out/site; a warning is an error
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --strict --site-dir out/site

wheel: $(SETUP)  ## build the wheel and the source archive into dist
	$(BIN)/python -m build --no-isolation --outdir dist

npm-package: player/node_modules/.package-lock.json  ## build the npm packages of player/ into dist
	mkdir -p dist
	cd player && npm pack --include-workspace-root $(addprefix --workspace packages/,decoder three playcanvas) --pack-destination ../dist

setup: $(SETUP)

models: $(MODELS)  ## install RAFT and SAM2, which come without weights; then their tests run with random ones

# LOCKED=1, as the workflows set it, installs only files whose hashes are in constraints.lock. torch, for test-all and models, is not there.
LOCKED ?=
# Python compiles the modules that a program imports. pip would compile all of them, for 20 seconds.
PIP := $(BIN)/python -m pip install --quiet --no-compile
INSTALL := $(PIP) --constraint constraints.txt
EDITABLE := $(INSTALL) --no-build-isolation $(if $(LOCKED),--no-deps )--editable
HASHED := $(PIP) --no-deps --require-hashes --requirement constraints.lock

$(RECON): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Splatreel needs Python 3.11 or newer; run: make PYTHON=python3.12")'
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(if $(LOCKED),$(HASHED))
	$(BIN)/python -c 'import editables, hatchling' 2>/dev/null || $(INSTALL) editables hatchling
	$(EDITABLE) '.[recon]'
	touch $@

$(SETUP): $(RECON)
	$(EDITABLE) '.[dev]'
	touch $@

$(ORACLES): $(SETUP)
	$(INSTALL) --no-build-isolation --editable '.[oracles]'
	touch $@

$(DOCS): pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(if $(LOCKED),$(HASHED))
	$(BIN)/python -c 'import editables, hatchling' 2>/dev/null || $(INSTALL) editables hatchling
	$(EDITABLE) '.[docs]'
	touch $@

# SAM2 has no wheel. Building it apart would download torch again, and its CUDA extension fills small holes only.
$(MODELS): $(ORACLES)
	SAM2_BUILD_CUDA=0 $(INSTALL) --no-build-isolation --editable '.[models]'
	touch $@

player/node_modules/.package-lock.json: player/package-lock.json
	npm --prefix player ci --no-audit --no-fund
	touch $@

clean:
	rm -rf $(VENV) out dist build player/node_modules
