# Two commands are enough on a machine with Rust and Python 3.10 or later: `make demo` and `make test`.
# Everything goes into a virtual environment inside the checkout.

PYTHON ?= python3
BIN := .venv/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check

.PHONY: demo test test-rust test-python lint bench extremes fuzz docs viewer clean

demo: .venv/demo
	$(BIN)/radiosity demo --output out

test: lint test-rust test-python

test-rust:
	cargo test --quiet

test-python: .venv/test
	$(BIN)/python -m pytest

lint: .venv/test
	cargo fmt --check
	cargo clippy --quiet --all-targets --features python -- --deny warnings
	RUSTDOCFLAGS="--deny warnings" cargo doc --quiet --no-deps
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/python -m mypy.stubtest radiosity._core

bench: .venv/test
	$(PIP) embreex || echo "embreex cannot be installed here: no comparison with Embree"
	$(PIP) pyviewfactor || echo "pyviewfactor cannot be installed here: no comparison with it"
	for bench in benches/*.py; do $(BIN)/python $$bench || exit 1; done
	$(BIN)/radiosity bench --output out

extremes: .venv/test
	$(BIN)/python tests/python/extremes.py

# Coverage-guided cases for the core, then damaged files and odd arguments for Python: so many seconds of a processor each.
# libFuzzer needs no nightly compiler without its sanitizers, only the flags by which LLVM counts what has run. Counting
# makes cases some six times as slow: 60 s are 10 of them.
FUZZ_SECONDS ?= 1800
FUZZ_FLAGS := --cfg fuzzing -Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4 \
  -Cllvm-args=-sanitizer-coverage-inline-8bit-counters -Cllvm-args=-sanitizer-coverage-pc-table \
  -Cllvm-args=-sanitizer-coverage-trace-compares -Ccodegen-units=1
HOST = $(shell rustc -vV | sed -n 's/^host: //p')
fuzz: .venv/test
	RUSTFLAGS="$(FUZZ_FLAGS)" cargo build --release --manifest-path tests/fuzz/Cargo.toml --target $(HOST) --target-dir target/fuzz
	mkdir -p out/fuzz
	target/fuzz/$(HOST)/release/core out/fuzz tests/data/corpus/core -artifact_prefix=out/ -timeout=60 -max_len=2000 \
	  -max_total_time=$(FUZZ_SECONDS)
	$(BIN)/python tests/python/fuzz.py --seconds $(FUZZ_SECONDS)

# The pages, notebooks and all, in target/docs/site.
docs: .venv/test
	$(PIP) '.[docs]'
	rm -rf target/docs
	mkdir -p target/docs
	cp -r docs target/docs/source
	cp -r python/notebooks target/docs/source
	cd target/docs && ../../$(BIN)/sphinx-build -W --keep-going -q source site

# The bundle is in the repository, so that only those who change the viewer need npm.
VIEWER := python/radiosity/viewer
viewer:
	mkdir -p target/viewer
	cp $(VIEWER)/package.json $(VIEWER)/package-lock.json $(VIEWER)/viewer.js target/viewer
	cd target/viewer && npm ci --silent && npm run --silent build
	cp target/viewer/bundle.js $(VIEWER)/bundle.js

# The environment is made anew when what it is built from has changed.
SOURCES := Cargo.toml Cargo.lock pyproject.toml $(shell find src python -name '*.rs' -o -name '*.py' -o -name '*.pyi' -o -name '*.js' -o -name '*.html' -o -name '*.wgsl')

.venv/demo: $(SOURCES) | .venv/bin/python
	sh tests/install_llvm.sh
	$(PIP) '.[mitsuba]' || (echo "Mitsuba cannot be installed here: the demo goes without it"; $(PIP) .)
	touch $@

.venv/test: $(SOURCES) | .venv/bin/python
	sh tests/install_llvm.sh
	sh tests/install_chromium.sh
	sh tests/install_vulkan.sh
	$(PIP) '.[test,mitsuba]'
	touch $@

.venv/bin/python:
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10) and "Python 3.10 or later is needed")'
	$(PYTHON) -m venv .venv

clean:
	rm -rf .venv target out
