# The one runner: `make check` while you work, `make test` before a push, `.ci/run` before a release.
.PHONY: help check style types changed test slow hunt docs bench results

SINCE ?= # a commit; by default, where this branch left origin/main

help: ## list the targets
	@grep -hE '^[a-z]+:.*##' Makefile | sed -E 's/:.*## /: /'

check: ## style, types, and the tests of what changed (SINCE=COMMIT), in about a minute
	@$(MAKE) --no-print-directory -j 2 style types changed

style:
	ruff check .
	ruff format --check .
	lint-imports

types:
	mypy

changed:
	@chosen=$$(python tests/support/affected.py $(SINCE)) && echo "$$chosen" && \
	    { [ -z "$$chosen" ] || pytest -q $$chosen; }

test: ## the default tests, on all cores
	pytest -q

slow: ## the slow tests; tests of pictures, pages and engines have further requirements (CONTRIBUTING.md)
	CAROM_EXAMPLES=all pytest -q -m "slow or needs or drawn"

hunt: ## two minutes of random scenes and of damaged and hostile files, with a new seed; exits with 1 after a fault
	tests/support/generators.sh

docs: ## the site, with its links checked
	NO_MKDOCS_2_WARNING=1 mkdocs build --quiet --strict --site-dir "$${TMPDIR:-/tmp}/carom-site"

bench: ## speed beside other engines, compared with the committed ratios; exits with 1 if carom got slower
	python benchmarks/gate.py

results: ## measure the ratios beside other engines again, and keep them as those of this processor
	python benchmarks/gate.py --save
	python benchmarks/few_contacts.py --rounds 15 --save
	python benchmarks/gravity.py direct --bodies 1024 4096 16384
	python benchmarks/gravity.py tree --bodies 100000 --shapes plummer --peers pytreegrav --methods tree
	python benchmarks/heap.py --bodies 1000 --threads 1
