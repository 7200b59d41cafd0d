# The whole set-up on a fresh machine: python3 (3.11 or later, with venv) and make are enough.
PYTHON ?= python3
VENV := .venv
PY := $(VENV)/bin/python
DOCS_PORT := 8000
BUILD_DOCS = $(PY) -m sphinx -W --keep-going -q -j 2 -d build/docs/doctrees docs build/docs/html

# Python keeps what it compiled: the collection of all tests takes 23 s of a processor without that, 7 s with it
unexport PYTHONDONTWRITEBYTECODE

.NOTPARALLEL:
.PHONY: help demo test check docs soak fuzz strangers strangers-kernel clean

help:
	@echo "make demo    the simulated plant in one process (installs what it needs into $(VENV))"
	@echo "make test    all tests"
	@echo "make check   lint, types, documentation"
	@echo "make docs    the book, built and served on http://127.0.0.1:$(DOCS_PORT)"
	@echo "make soak    the long runs"
	@echo "make fuzz    random inputs for parsers and machines, guided by coverage (MINUTES=10 TARGETS=... SEED=...)"
	@echo "make strangers-kernel  all tests with the kernel's own serial drivers in a virtual machine (90 MB of packages)"
	@echo "make strangers  the tests with programs of others (installs them: Debian packages, and Python's into $(VENV))"

demo: $(VENV)/.core
	$(VENV)/bin/dpstack demo

# Three files at a time, whatever the computer has: one of them waits for a port or a program as a rule. More would let
# these wait for a processor
test: $(VENV)/.test
	$(PY) -m pytest -m "not soak and not strangers and not check" -n 3 --dist loadfile

# The book is built beside the types; its programs on ptys keep to one process, because they need a processor in time
check: $(VENV)/.check
	$(PY) -m ruff check .
	$(PY) -m ruff format --check .
	$(BUILD_DOCS) & build=$$!; $(PY) -m mypy \
		&& $(PY) -m mypy.stubtest dpstack.blocking --mypy-config-file pyproject.toml \
		&& $(PY) -m pytest tests/test_docs.py tests/test_imports.py; \
		judged=$$?; wait $$build && exit $$judged
	$(PY) -m pytest -m check tests/blocking tests/bridge_mqtt tests/test_book_names.py
	$(PY) -m pytest -p tools.book_blocks -n 1 README.md docs

# Only pages that changed are read again; rm -r build/docs builds the whole book
docs: $(VENV)/.check
	$(BUILD_DOCS)
	@echo "the book is on http://127.0.0.1:$(DOCS_PORT) until Ctrl-C"
	@$(PY) -m http.server --bind 127.0.0.1 --directory build/docs/html $(DOCS_PORT)

# Summed up from its files, run one by one: about an hour of a processor (some of it estimated), two to three where others
# compute beside it. The longest: soak/test_soak_day.py, a day of virtual time in some 13 minutes; about five minutes each:
# fdl/test_autobaud.py, dp/acyclic/test_acyclic_endurance.py.
# make soak TESTS=tests/dp runs a part (ptys: tests/cli, tests/drivers), make soak SEED=... looks again where an earlier
# run looked
soak: SEED := $(shell date +%s)
soak: $(VENV)/.test
	@echo "what hypothesis tries: SEED=$(SEED)"
	$(PY) -m pytest -m soak --hypothesis-profile=soak --hypothesis-seed=$(SEED) $(TESTS)

# Inputs that fail are written into build/fuzz, with a line that says how to replay them; the seed makes a run repeat
fuzz: MINUTES := 10
fuzz: SEED := 1
fuzz: $(VENV)/.fuzz
	$(PY) -m tools.fuzz --minutes $(MINUTES) --seed $(SEED) $(TARGETS)

# Programs of others at one end: each is installed where that may be (root, or sudo without a password), run in processes
# of its own, and missed with an error, not skipped. make strangers TESTS=tests/strangers/test_report_in_chromium.py runs a part
strangers: $(VENV)/.test
	$(PY) -m tools.strangers $(TESTS)

# The drivers of adapters that people own, in QEMU; make strangers has one boot of them, this target all. About ten minutes
# of a processor; the packages stay in ~/.cache/dpstack-kernel
strangers-kernel: $(VENV)/.test
	$(PY) -m tools.strangers --kernel $(TESTS)

clean:
	rm -rf $(VENV) build dist *.egg-info drives/*.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis

# An environment that is there but whose interpreter does not run (copied, or python3 was updated) is made anew.
$(PY):
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
	  || { echo "dpstack needs Python 3.11 or later; name one: make PYTHON=python3.11 ..." >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)

$(VENV)/.core: pyproject.toml | $(PY)
	$(PY) -m pip install --quiet --disable-pip-version-check -e '.[screen,web]'
	@touch $@

$(VENV)/.test: pyproject.toml | $(PY)
	$(PY) -m pip install --quiet --disable-pip-version-check -e '.[test]'
	@touch $@ $(VENV)/.core

$(VENV)/.check: pyproject.toml | $(PY)
	$(PY) -m pip install --quiet --disable-pip-version-check -e '.[test,check,docs]'
	@touch $@ $(VENV)/.core $(VENV)/.test

# atheris has wheels for Linux on x86-64 only: elsewhere the targets run without it, and tools.fuzz says so.
$(VENV)/.fuzz: pyproject.toml | $(VENV)/.test
	-$(PY) -m pip install --quiet --disable-pip-version-check -e '.[test,fuzz]'
	@touch $@
