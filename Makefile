# The user's commands; `make` alone lists them. Everything they build is below .venv, build and out.
SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.ONESHELL:
.DELETE_ON_ERROR:
.NOTPARALLEL:
.DEFAULT_GOAL := help
.PHONY: help paper explorer explorer-test docs docs-links wheel wheel-test test test-all fuzz asan tsan aarch64 bench bench-step bench-ratios bench-peers bench-reachy format clean setup test-setup benchmark-setup browser-setup peer-setup \
  system FORCE

PYTHON ?= python3
# The tools are those of the environment, whatever else the machine or an active shell offers.
export PATH := $(CURDIR)/.venv/bin:$(PATH)
unexport PYTHONPATH PYTHONHOME

# Each stamp is written by the last command of its recipe, so that an interrupted step is done again.
VENV := .venv/.stamp-venv
BUILD_TOOLS := .venv/.stamp-build-tools
ALL_TOOLS := .venv/.stamp-all-tools
PACKAGE := .venv/.stamp-package
# Folders are listed too: their time changes when a file is removed.
# docs with its slash: `docs` is a target, which would be made before the package.
SOURCES := CMakeLists.txt pyproject.toml README.md LICENSE \
  $(shell find cpp docs/ licenses python -name __pycache__ -prune -o -print 2>/dev/null)
CXX_FILES = $$(find cpp tests/cpp examples explorer benchmarks \( -name '*.cpp' -o -name '*.hpp' \) 2>/dev/null)

help:
	@cat <<'END'
	make paper    set up, run the paper's experiment, write out/paper and print the table of results
	make explorer  build the explorer, a page that runs the core in a browser (needs npm), for hexservo explore
	make test     set up, run every test and check; the last line is passed or failed
	make docs     build the site, build/site/index.html: tutorials, guides, reference, gallery (make docs-links: links to the network)
	make wheel    build dist/: the sources' archive and a wheel that needs no compiler (PYTHONS='python3.11 python3.13': one for each)
	make wheel-test  the same in two folders with equal bytes, and tried in new Debian systems without a compiler (as root)
	make test-all  the same, the site, the wheel, and the explorer's tests (make explorer-test), slow tests, sanitizers (make asan, make tsan), 64-bit ARM (make aarch64) and a minute of make fuzz
	make bench    measure this machine: servo tick, runs, batches, the core's parts; written to out/bench and BENCHMARKS.md
	make bench-step  what a step costs by part: instructions, loads, stores, time; written to BENCHMARKS.md (needs valgrind)
	make bench-ratios  packs to a bare loop, sampled to continuous mode, pbvs to composite: ratios in one run; written to BENCHMARKS.md
	make bench-peers  compare with NumPy, SciPy, numba, JAX, MuJoCo, fuzzylite and ViSP (installed too; APT=no: not the last two)
	make bench-reachy  face tracking on the model of a robot that others built, beside its own law (OPTIONS=--quick: a minute)
	make asan     run the C++ tests under the address and undefined-behaviour sanitizers
	make tsan     run the C++ tests under the thread sanitizer
	make aarch64  run the C++ tests for 64-bit ARM in an emulator, and compare exported programs with simulated controllers bit for bit
	make fuzz     random scenarios, ticks, files and kills for SECONDS=60, from SEED= (drawn and printed without one)
	make format   format the C++ and Python files
	make clean    remove what the others built (.venv, build, dist, the explorer, caches), not the results in out
	The first two install what is missing, Debian packages included, and are quick the second time.
	PYTHON=python3.12 chooses the interpreter (at least 3.10) that .venv is made from.
	END

paper: setup
	@hexservo run paper --out out/paper --force

# Compiled by clang of PyPI's ziglang, bundled by esbuild of npm; then the package is installed again, with the page.
PAGE := python/hexservo/explorer.html
explorer: $(PACKAGE) $(VENV)
	@if ! command -v npm >/dev/null; then
	  echo "The explorer is bundled with npm, which was not found: install the package npm." >&2
	  exit 1
	fi
	python -m pip install --quiet --group explorer
	python explorer/build.py $(PAGE)
	$(SETUP) setup

explorer-test: explorer $(ALL_TOOLS) browser-setup
	@python -m pytest tests/python/test_explorer.py

# Every warning is an error, and every link within the site is followed; those to the network only by docs-links.
docs docs-links: $(PACKAGE) $(VENV)
	@python -m pip install --quiet --group docs
	python docs/tools/build_site.py $(if $(filter docs-links,$@),--links)

# With the explorer in it where npm is there. The test builds twice, and uses the wheels in new Debian systems.
wheel wheel-test: $(BUILD_TOOLS)
	@if command -v npm >/dev/null; then
	  $(SETUP) explorer
	else
	  echo "npm was not found: a wheel without the explorer."
	  rm -f $(PAGE)  # of an earlier build
	fi
	python -m pip install --quiet --group release
	python release/build_wheels.py --out dist $(foreach python,$(PYTHONS),--python $(python)) $(if $(filter wheel-test,$@),--again)
	if [ $@ = wheel ]; then exit 0; fi
	if [ "$(APT)" != no ]; then
	  $(SETUP) system PEER=mmdebstrap PEER_PROGRAM=mmdebstrap || echo "Going on without mmdebstrap."
	fi
	python release/try_wheels.py

# A name is added to `failed` and the next check still runs. The set-up is a separate make,
# so that its failure ends in the same last line.
SETUP = $(MAKE) --no-print-directory
test:
	@failed=()
	trap 'exit 130' INT
	check() {
	  local name=$$1
	  shift
	  printf '\n--- %s: %s\n' "$$name" "$$(printf '%.100s' "$$*")"
	  "$$@" || failed+=("$$name")
	}
	cpp_format() { clang-format --dry-run -Werror $(CXX_FILES); }
	if $(SETUP) test-setup; then
	  check ctest cmake --workflow --preset dev
	  check pytest python -m pytest --numprocesses auto --dist loadfile --no-loadscope-reorder
	  check stubtest python -m mypy.stubtest --mypy-config-file pyproject.toml hexservo._core
	  check mypy mypy
	  check ruff ruff check
	  check ruff-format ruff format --check
	  check clang-format cpp_format
	else
	  failed=(set-up)
	fi
	echo
	if [ $${#failed[@]} -gt 0 ]; then
	  echo "make test: failed: $${failed[*]}"
	  exit 1
	fi
	echo "make test: passed"

# One after another; the first that fails ends it.
test-all: test
	@python -m pytest -m slow --numprocesses auto --durations 0 --durations-min 10
	$(SETUP) explorer-test
	$(SETUP) docs
	$(SETUP) wheel-test
	$(SETUP) asan
	$(SETUP) tsan
	$(SETUP) aarch64
	$(SETUP) fuzz
	echo "make test-all: passed"

asan: $(BUILD_TOOLS)
	@cmake --workflow --preset asan

tsan: $(BUILD_TOOLS)
	@cmake --workflow --preset tsan

aarch64: $(PACKAGE) $(ALL_TOOLS)
	@$(SETUP) system PEER="g++-aarch64-linux-gnu" PEER_PROGRAM=aarch64-linux-gnu-g++
	$(SETUP) system PEER=qemu-user PEER_PROGRAM=qemu-aarch64
	cmake --workflow --preset aarch64
	python -m pytest -m slow tests/python/test_replay.py -k arm

# SECONDS is a variable of the shell too, and of no environment; it is make's here.
fuzz: SECONDS = 60
fuzz: $(PACKAGE) $(ALL_TOOLS)
	@cd tests/python
	nice python -m fuzz --seconds "$(SECONDS)" $(if $(SEED),--seed "$(SEED)") $(foreach name,$(CAMPAIGN),--campaign $(name))

# Google Benchmark is wanted, for the parts of the core, and not needed; APT=no goes without it where it is missing.
benchmark-setup:
	@if [ "$(APT)" = no ]; then exit 0; fi
	$(SETUP) system PEER=libbenchmark-dev PEER_FILE=benchmark/benchmark.h || echo "Going on without Google Benchmark."

# A browser is wanted, for the tests of the report, and a reader of what it prints; neither is needed.
browser-setup:
	@if [ "$(APT)" = no ]; then exit 0; fi
	$(SETUP) system PEER=chromium PEER_PROGRAM=chromium || echo "Going on without Chromium: tests in a browser are skipped."
	$(SETUP) system PEER=poppler-utils PEER_PROGRAM=pdftotext || echo "Going on without pdftotext: printed words are not read."

KERNELS := build/benchmarks
bench: $(PACKAGE) benchmark-setup
	@hexservo bench --out out/bench --force
	mkdir -p out/bench-kernels build
	rm -f out/bench-kernels/kernels.json
	if cmake -S . -B $(KERNELS) -G Ninja -DCMAKE_BUILD_TYPE=Release -DHEXSERVO_BENCHMARKS=ON >$(KERNELS).log 2>&1; then
	  cmake --build $(KERNELS) --target hexservo_parts
	  $(KERNELS)/hexservo_parts --benchmark_min_time=0.1 --benchmark_repetitions=7 \
	    --benchmark_enable_random_interleaving=true --benchmark_report_aggregates_only=true \
	    --benchmark_out=out/bench-kernels/kernels.json --benchmark_out_format=json
	else
	  echo "The parts are not measured: $$(grep -m 1 -i 'need' $(KERNELS).log || echo "see $(KERNELS).log")"
	fi
	python benchmarks/tables.py

bench-peers: $(PACKAGE) peer-setup
	@python benchmarks/peers/run.py --markdown BENCHMARKS.md

# The peers are wanted and not needed: whatever cannot be installed is left out, and the benchmark lists it.
APT ?= yes
# Downloads the package reachy-mini of PyPI to build/reachy; where it cannot be had, hexservo's own model stands in for it.
bench-reachy: $(PACKAGE) $(ALL_TOOLS)
	@cd benchmarks/reachy && python -m face_tracking $(OPTIONS)

# The time by part needs perf too; where it is missing or forbidden, the column is empty.
bench-step: $(PACKAGE) $(ALL_TOOLS)
	@if [ "$(APT)" != no ]; then $(SETUP) system PEER=valgrind PEER_PROGRAM=valgrind || echo "Going on without valgrind."; fi
	python benchmarks/step_cost.py

bench-ratios: $(PACKAGE)
	@python benchmarks/ratios.py $(OPTIONS)

peer-setup: $(BUILD_TOOLS)
	@if [ ! -e .venv/.stamp-peers ] || [ pyproject.toml -nt .venv/.stamp-peers ]; then
	  echo "Installing the Python peers into .venv"
	  if python -m pip install --quiet --group peers; then
	    touch .venv/.stamp-peers
	  else
	    for peer in scipy numba jax mujoco; do python -m pip install --quiet "$$peer" || true; done
	  fi
	fi
	if [ "$(APT)" = no ]; then exit 0; fi
	$(SETUP) system PEER=libfuzzylite-dev PEER_FILE=fl/Headers.h || echo "Going on without fuzzylite."
	$(SETUP) system PEER=libvisp-vs-dev PEER_FILE=visp3/vs/vpServo.h || echo "Going on without ViSP."

format: $(ALL_TOOLS)
	@ruff check --fix-only --exit-zero
	ruff format
	clang-format -i $(CXX_FILES)

clean:
	@rm -rf .venv build dist $(PAGE) .hypothesis .mypy_cache .pytest_cache .ruff_cache
	find cpp python tests benchmarks -name __pycache__ -prune -exec rm -rf {} + 2>/dev/null || true

setup: $(PACKAGE)

test-setup: $(PACKAGE) $(ALL_TOOLS) benchmark-setup browser-setup

# What only the system can give: checked each time, installed through apt where it is missing. PEER is one package more,
# whose header is PEER_FILE, or whose program is PEER_PROGRAM.
system:
	@python=$$(command -v .venv/bin/python || command -v "$(PYTHON)" || true)
	if [ -z "$$python" ] || ! "$$python" -c 'import sys; sys.exit(sys.version_info < (3, 10))'; then
	  found=$$("$(PYTHON)" --version 2>/dev/null || echo "not there")
	  echo "hexservo needs Python 3.10 or newer, and \"$(PYTHON)\" is $$found: name another one with make PYTHON=..." >&2
	  exit 1
	fi
	version=$$("$$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
	has_venv() { "$$python" -c 'import ensurepip, venv' 2>/dev/null; }
	has_headers() { test -e "$$("$$python" -c 'import sysconfig; print(sysconfig.get_path("include"))')/Python.h"; }
	has_file() {
	  local prefix
	  for prefix in $${CMAKE_PREFIX_PATH:+$${CMAKE_PREFIX_PATH//:/ }} /usr/local /usr; do
	    if [ -e "$$prefix/$$1" ]; then return 0; fi
	  done
	  return 1
	}
	has_peer() {
	  if [ -n "$(PEER_PROGRAM)" ]; then command -v "$(PEER_PROGRAM)" >/dev/null; return; fi
	  has_file "include/$(PEER_FILE)" || has_file "include/$$($(CXX) -print-multiarch)/$(PEER_FILE)"
	}
	missing() {
	  command -v "$(firstword $(CXX))" >/dev/null || echo g++
	  has_venv || echo "python$$version-venv"
	  has_headers || echo "python$$version-dev"
	  has_file share/eigen3/cmake/Eigen3Config.cmake || echo libeigen3-dev
	  has_file include/doctest/doctest.h || echo doctest-dev
	  if [ -n "$(PEER)" ]; then has_peer || echo "$(PEER)"; fi
	}
	packages=$$(missing | paste -s -d ' ')
	if [ -z "$$packages" ]; then exit 0; fi
	echo "Missing system packages: $$packages"
	give_up() {
	  echo "$$1 Type this as root (or after sudo), then try again:" >&2
	  echo "  apt-get update && apt-get install -y $$packages" >&2
	  exit 1
	}
	command -v apt-get >/dev/null || give_up "There is no apt-get here. Find these packages' like in your system; on Debian:"
	as_root=()
	if [ "$$(id -u)" != 0 ]; then
	  # Without a terminal no password can be typed: fail at once instead of waiting for it.
	  as_root=(sudo)
	  if [ ! -t 0 ]; then as_root+=(-n); fi
	  command -v sudo >/dev/null || give_up "They need root's rights, and there is no sudo here."
	  "$${as_root[@]}" true || give_up "They need root's rights, and sudo does not grant them."
	fi
	as_root+=(env DEBIAN_FRONTEND=noninteractive)
	install=("$${as_root[@]}" apt-get -q install -y --no-install-recommends $$packages)
	echo "Installing them with: $${install[*]}"
	"$${as_root[@]}" apt-get -q update || echo "apt-get update failed; trying with the lists that are there." >&2
	"$${install[@]}" || give_up "apt-get could not install them."
	packages=$$(missing | paste -s -d ' ')
	if [ -n "$$packages" ]; then
	  echo "Still missing for $$python (version $$version) after the installation: $$packages." \
	    "Another interpreter may be chosen with make PYTHON=/usr/bin/python3" >&2
	  exit 1
	fi

# An environment whose interpreter has gone (an upgrade of the system) is made again.
ifneq ($(shell .venv/bin/python -c 'print("works")' 2>/dev/null),works)
$(VENV): FORCE
endif
$(VENV): | system
	@echo "Making .venv"
	rm -rf .venv
	"$(PYTHON)" -m venv .venv
	python -m pip install --quiet --upgrade 'pip>=25.1'
	touch $@

$(BUILD_TOOLS): pyproject.toml $(VENV) | system
	@echo "Installing the build tools into .venv"
	python -m pip install --quiet --group build
	touch $@

$(ALL_TOOLS): pyproject.toml $(VENV) | system
	@echo "Installing the test tools into .venv"
	python -m pip install --quiet --group dev
	touch $@

$(PACKAGE): $(SOURCES) $(BUILD_TOOLS) | system
	@echo "Building and installing hexservo into .venv (the first time: some 8 minutes of processor time)"
	mkdir -p build
	touch $@.begun  # the stamp's time: what is saved during the build is newer than the stamp
	if ! python -m pip install --verbose --no-build-isolation . 2>&1 | tee build/install.log \
	  | sed -unE 's#.*\[([0-9]+)/([0-9]+)\] Building.*#  built \1 of \2#p'; then
	  tail -n 60 build/install.log >&2
	  echo "The build failed; its output is in build/install.log" >&2
	  exit 1
	fi
	mv $@.begun $@
