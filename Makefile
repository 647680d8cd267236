# Every command of the project, by one name. Hooks and CI call these same targets.
#
#   make setup   everything a developer needs, the extension included
#   make lint    what a change must pass besides its tests
#   make test    all tests, the Rust ones included

MATURIN := uvx --from 'maturin>=1.9.4,<2'
# zig links against an old glibc, which the compiler of a new system does not.
MATURIN_ZIG := $(MATURIN:uvx=uvx --with ziglang==0.17.*) maturin
PYTHON_SOURCES := $(wildcard python tests docs benches notebooks)

.DEFAULT_GOAL := all
.PHONY: all setup build fmt lint lint-rust lint-python lint-stubs test docs bench demo notebooks wheel clean help

all: lint test ## lint, then test

help: ## this list
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 14

# The dependencies alone; the extension is built by what needs it.
.venv:
	uv sync --locked --no-install-project

setup: ## install the dependencies and build the extension
	uv sync --locked

build: | .venv ## optimised extension, put where Python finds it
	$(MATURIN) maturin develop --release --locked --uv

fmt: | .venv ## format everything, and mend what the linters can mend
	cargo fmt
	uv run --no-sync ruff format $(PYTHON_SOURCES)
	uv run --no-sync ruff check --fix $(PYTHON_SOURCES)

lint: lint-rust lint-python lint-stubs ## all checks that run no test

# Without the `python` feature first: the core must be whole without it.
lint-rust: | .venv
	cargo fmt --check
	cargo clippy --locked --all-targets -- -D warnings
	uv run --no-sync cargo clippy --locked --all-targets --features python,gpu -- -D warnings
	RUSTDOCFLAGS='-D warnings' cargo doc --locked --no-deps --quiet

lint-python: | .venv
	uv run --no-sync ruff check $(PYTHON_SOURCES)
	uv run --no-sync ruff format --check $(PYTHON_SOURCES)
	uv run --no-sync mypy

# Compares the hand-written stub with the extension, so it needs the extension built.
lint-stubs:
	uv run --locked python -m mypy.stubtest treelod._core

test: ## every test that is not marked slow
	uv run --locked pytest

# All pages anew each time: a page that is not read again would not tell its warnings again.
docs: ## the documentation's site, target/docs/index.html; warnings are errors
	uv run --locked --group docs sphinx-build -E -q -W --keep-going -b html -c docs \
		-d target/docs-read . target/docs

# For the techniques: many repeats at few views, since the time is asked for and not the error.
bench: ## times against other tools, and of every technique; close other programs first
	uv run --locked --extra bench --extra validate treelod bench raster --output target/raster.jsonl
	uv run --locked --extra bench --extra validate treelod bench bake --output target/bake.jsonl
	uv run --locked --extra bench treelod bench clusters --output target/clusters.jsonl
	uv run --locked --extra bench treelod bench collapse --output target/collapse.jsonl
	uv run --locked --extra bench treelod bench splats --output target/splats.jsonl
	uv run --locked treelod compare chestnut --output target/bench --azimuths 2 --elevations 0 \
		--reference-samples 16 --repeats 25

demo: ## grow a tree, measure it, write demo/report.html
	uv run --locked treelod demo

notebooks: ## run the notebooks from nothing, and store them with their outputs
	uv run --locked python notebooks/make_notebooks.py

wheel: ## dist/*.whl for any Linux with glibc 2.28 or later
	$(MATURIN_ZIG) build --release --locked --zig --compatibility manylinux_2_28 --out dist

# uv takes the extension from its cache while the sources' times are unchanged, even if the file
# that it once put into python/ is gone. A new time on one of its cache keys makes it build again.
clean: ## remove what was built
	cargo clean
	rm -rf dist demo notebooks/sweeps .mypy_cache .pytest_cache .ruff_cache .hypothesis
	rm -f python/treelod/_core*.so
	find python tests -name __pycache__ -type d -prune -exec rm -rf {} +
	touch pyproject.toml
