# Everything a user or developer runs. Each target does its own set-up inside this folder.

PYTHON ?= python3
TOOLS := .tools
BIN := .venv/bin
FILES := python tests benches examples docs

PAGE := python/markerloom/studio/page/index.html
WEB := $(shell find web -path web/node_modules -prune -o -type f -print)

.PHONY: demo test check web web-check bench results picture tour wheel lock setup clean

demo: setup $(PAGE) ## simulate a capture, reconstruct it, write a report; ends with a take ready to be viewed
	$(BIN)/markerloom demo

test: setup $(PAGE) ## the quick tests; those in a browser where there is Chromium
	cargo test --quiet --release --locked --workspace
	@if command -v npm >/dev/null; then cd web && npm test --silent; fi
	$(BIN)/pytest -n auto -m "not slow"

check: setup web-check ## formatting, lints, types, all tests, the README and the examples: what CI runs
	cargo fmt --check
	cargo clippy --quiet --release --locked --workspace --all-targets -- -D warnings
	$(BIN)/ruff format --check $(FILES)
	$(BIN)/ruff check $(FILES)
	$(BIN)/pyright
	cargo test --quiet --release --locked --workspace
	$(BIN)/pytest -n auto

web: $(PAGE) ## the studio's page, where its sources are newer

# Without Node the page is not built, and `markerloom view` says how to get it.
$(PAGE): $(WEB)
	@if command -v npm >/dev/null; then \
		cd web && npm ci --silent --no-audit --no-fund && npm run --silent build; \
	else echo "npm is missing: the studio's page is not built (install Node 20 or newer)"; fi

web-check: $(PAGE) ## the page's formatting, lints, types and tests
	cd web && npm run --silent check && npm test --silent

bench: setup ## time per frame, by Criterion
	cargo bench --locked -p markerloom-core

results: setup ## every accuracy figure of docs/results.md
	$(BIN)/markerloom bench

picture: setup ## the README's picture, from the demo
	$(BIN)/python docs/make_picture.py

tour: setup $(PAGE) ## the studio's pictures in docs/tour, from the demo
	$(BIN)/python docs/make_tour.py

wheel: setup $(PAGE) ## a wheel for this machine in dist/, with the studio's page
	$(BIN)/maturin build --release --out dist

lock: $(TOOLS)/bin/uv ## renew requirements.lock from pyproject.toml
	$(TOOLS)/bin/uv pip compile --quiet --universal --python-version 3.11 --group dev --generate-hashes \
		--no-header --output-file requirements.lock pyproject.toml

setup: .venv/ready
	@command -v cargo >/dev/null || { echo "cargo is missing: install Rust 1.89 or newer from https://rustup.rs"; exit 1; }

	@VIRTUAL_ENV=$(CURDIR)/.venv PATH=$(CURDIR)/$(TOOLS)/bin:$$PATH $(BIN)/maturin develop --quiet --release --uv

.venv/ready: $(TOOLS)/bin/uv requirements.lock pyproject.toml
	$(TOOLS)/bin/uv venv --quiet --clear --python $(PYTHON) .venv
	VIRTUAL_ENV=.venv $(TOOLS)/bin/uv pip sync --quiet --require-hashes requirements.lock
	@touch $@

$(TOOLS)/bin/uv:
	@command -v $(PYTHON) >/dev/null || { echo "$(PYTHON) is missing: install Python 3.11 or newer"; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
		|| { echo "$(PYTHON) is too old: Python 3.11 or newer is needed (make PYTHON=python3.12 ...)"; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null \
		|| { echo "$(PYTHON) has no venv module: install it (Debian, Ubuntu: apt install python3-venv)"; exit 1; }
	$(PYTHON) -m venv $(TOOLS)
	$(TOOLS)/bin/pip install --quiet --disable-pip-version-check uv

clean:
	rm -rf target .venv $(TOOLS) out dist web/node_modules python/markerloom/studio/page
