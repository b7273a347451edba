# Every target makes the environment it needs (see scripts/environment.sh). PYTHON=/path/to/python3.11 chooses the
# interpreter, OUT=folder where results go.
VENV ?= .venv
OUT ?= out
RUN = $(VENV)/bin/python

.DEFAULT_GOAL := help
.PHONY: help demo paper doctor bench bench-scaling test test-matrix test-gui site docs-images lint format extension portable release clean environment browser blender-window \
        environment-test environment-bench environment-docs

help: ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## /  make \1	/p' $(MAKEFILE_LIST) | expand -t 22

environment:
	@PYTHON="$(PYTHON)" scripts/environment.sh $(VENV) runtime

environment-test:
	@PYTHON="$(PYTHON)" scripts/environment.sh $(VENV) runtime test cluster

environment-docs:
	@PYTHON="$(PYTHON)" scripts/environment.sh $(VENV) docs

environment-bench:
	@PYTHON="$(PYTHON)" scripts/environment.sh $(VENV) runtime bench cluster

demo: $(OUT)/demo/capture/capture.toml ## photographs of a tile, rendered, to their material, in three to ten minutes
	$(RUN) -m irpso_addon recover $(OUT)/demo/capture --distance 508 --crop 25,51,378,378 --hold-out auto -o $(OUT)/demo
	$(RUN) -m irpso_addon export $(OUT)/demo --format turntable --replace -o $(OUT)/demo/turntable.png
	@echo "$(OUT)/demo/relit.png: photographs that were left out of the recovery, beside the material under their lights"
	@echo "$(OUT)/demo/turntable.png: the tile tilting under a lamp"
	@echo "$(OUT)/demo/material.blend: the material in Blender; docs/worked_example.md explains the figures above"

# Numbers that a photographer knows: the ball's radius and the string of the lamp, in millimetres.
$(OUT)/demo/capture/capture.toml: $(OUT)/demo/sample/README.txt
	$(RUN) -m irpso_addon calibrate $(OUT)/demo/sample/photographs --radius 20 --lamp-distance 950 -o $(OUT)/demo/capture

$(OUT)/demo/sample/README.txt: | environment
	$(RUN) -m irpso_addon sample -o $(OUT)/demo/sample

paper: environment ## the paper's experiment at full size; QUICK=1 in small, in less than three minutes
	$(RUN) -m irpso_addon demo $(if $(QUICK),--quick) -o $(OUT)/paper

doctor: environment ## what GPU there is, and what the program will use of it
	$(RUN) -m irpso_addon doctor

bench: environment-bench ## what is timed, beside its peers, into docs/benchmarks; QUICK=1 only tries it, AGAIN=1 forgets
	$(RUN) -m benchmarks.run $(if $(QUICK),--quick) $(if $(AGAIN),--again)

bench-scaling: environment-bench ## one swarm, and a recovery, on ranks, threads and GPUs, into docs/benchmarks; QUICK=1, AGAIN=1
	$(RUN) -m benchmarks.run $(if $(QUICK),--quick) $(if $(AGAIN),--again) swarm_quality swarm_scaling recovery_scaling killed

test: environment-test lint ## all checks: style, unit tests, tests in headless Blender
	$(RUN) tests/run.py

test-matrix: environment-test ## the headless Blender tests on every supported version of Blender
	$(RUN) tests/matrix.py

test-gui: environment-test ## the tests in a real Blender window: BLENDER=/path/to/blender, or Debian's, built once
	$(RUN) tests/run_gui.py $(ONLY)

browser: environment-test # Chromium for the tests of the web page; without it they skip
	@PYTHONPATH=scripts $(RUN) -c "from blender_window.debian import need_programs; need_programs({'chromium': 'chromium'})"

blender-window: environment-test # Debian's Blender for test-gui, built once
	@PYTHONPATH=scripts $(RUN) -c "from blender_window.blenders import find_blender; find_blender()"

site: environment-docs ## the guide as a site that needs no network, into out/site/html; broken links fail
	$(RUN) scripts/guide/build.py $(OUT)/site

docs-images: environment ## the guide's pictures, of the sample and a Blender window, into docs/images; ONLY="stills panels views"
	$(RUN) scripts/docs_images.py $(ONLY)

lint: environment-test ## style and types only
	$(RUN) -m ruff check --quiet .
	$(RUN) -m ruff format --check --quiet .
	$(RUN) -m mypy --no-error-summary

format: environment-test ## rewrite the sources in the style that lint asks for
	$(RUN) -m ruff check --quiet --fix .
	$(RUN) -m ruff format --quiet .

extension: environment ## the zips that Blender installs, into dist/; tries this system's in Blender (BLENDER=…)
	$(RUN) scripts/extension.py dist
	BLENDER="$(BLENDER)" $(RUN) scripts/install_extension.py dist

portable: environment ## Python, Blender's wheel and the program in one archive, into dist/, for a Linux node without a network
	$(RUN) scripts/portable.py dist

release: environment ## the zips with checksums and notes from CHANGELOG.md, into dist/, from a commit
	$(RUN) scripts/release.py dist

clean: ## remove what the targets made, the environments included
	rm -rf .venv .venv-* out dist build .cache .pytest_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
