# Everything a fresh machine needs comes from `make demo` or `make test`: system libraries (when root and missing),
# a virtual environment, pinned packages.
#   make demo    a small real fire: simulated, rendered, reconstructed, scored, shown (out/demo/report.html)
#   make test    the test suite
#   make quick   the part of it for a loop while you work: under a minute on two cores
#   make lint    the rules, the format and the types of the code
#   make coverage  the quick tests with the share of lines that they run
#   make bench   eight functions' CPU seconds against another commit (COMMIT, default HEAD), on this machine
#   make docs    the documents as a web site (build/site/index.html)
#   make evidence  the figures that pages quote, measured again where evidence/NAME.json is missing
#   make dist    wheel, source archive, add-on zip and sample with their checksums (dist/)
#   make addon   the Blender add-on as a zip (dist/gaussians_on_fire-VERSION.zip); needs nothing but Python
# JOBS: how many files of tests run side by side.
# TORCH: which PyTorch to install, by version only, as builds differ; one that is in the environment already is kept.
# Every other package stands with its hash in requirements.lock (tools/lock.py writes it), pip and setuptools too.
PYTHON ?= python3.11
TORCH  ?= torch==2.13.0
OUT    ?= out/demo
JOBS   ?= 2
VENV   := .venv
READY  := $(VENV)/.ready

.PHONY: demo test quick coverage bench addon dist docs evidence setup lint clean

demo: setup
	$(VENV)/bin/gof demo --out $(OUT)

test: setup
	$(VENV)/bin/python -m pytest -n $(JOBS) --dist loadfile $(ARGS)

quick: setup
	$(VENV)/bin/python -m pytest -q -m "not long and not blender and not slow and not gpu" $(ARGS)

coverage: setup
	$(VENV)/bin/python -m pytest -q -m "not long and not blender and not slow and not gpu" --cov=gof --cov=benchmark --cov=blender_addon --cov-report=term:skip-covered $(ARGS)

bench: setup
	$(VENV)/bin/python tools/bench.py $(or $(COMMIT),HEAD) $(ARGS)

addon:
	$(PYTHON) tools/build_addon.py

dist: setup
	$(VENV)/bin/python tools/dist.py

docs: setup
	$(VENV)/bin/python -m pip install --quiet -e ".[site]"
	$(VENV)/bin/python -m tools.site

evidence: setup
	$(VENV)/bin/python -m tools.evidence $(ARGS)

setup: $(READY)

$(READY): pyproject.toml requirements.lock tools/system_packages.sh tools/setup.sh
	bash tools/setup.sh "$(VENV)" "$(PYTHON)" "$(TORCH)"
	touch $@

lint: setup
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/python -m mypy
	$(VENV)/bin/python -m tools.count_type_errors

clean:
	rm -rf out build *.egg-info
