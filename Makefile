# Commands for development. .ci/run runs the same checks in a fresh environment.
.PHONY: dev format lint test bench docs linkcheck fuzz
NAME ?= chunking

dev:
	pip install -e ".[fsspec,test,lint,docs]"

format:
	cargo fmt
	ruff check --fix
	ruff format

lint:
	cargo fmt --check
	cargo clippy --all-targets -- -D warnings
	cargo clippy --all-targets --features python -- -D warnings
	ruff check
	ruff format --check
	mypy
	python -m mypy.stubtest xbus._core
	codespell

test:
	cargo test --features export
	pytest -n auto

bench:
	cargo bench --bench decode
	python benches/peers.py
	python benches/export.py
	python benches/ros.py
	python benches/threads.py
	python benches/batch.py
	python benches/report.py
	python benches/memory.py
	python benches/startup.py
	python benches/virtual.py
	python benches/live.py
	python benches/monitor.py
	python benches/delay.py
	python benches/flood.py
	python benches/soak.py 60
	python benches/can.py

docs:
	@python -c "import xbus, furo, myst_parser, sphinx" 2>/dev/null || \
	  { echo "make docs needs xbus, sphinx, furo and myst-parser; activate a virtual environment and run: make dev"; exit 1; }
	python -m sphinx -W -b html docs docs/_build/html
	python docs/check_links.py docs/_build/html

linkcheck:
	python -m sphinx -b linkcheck docs docs/_build/linkcheck

fuzz:
	mkdir -p /tmp/xbus-fuzz/$(NAME)
	cargo fuzz run -s none $(NAME) /tmp/xbus-fuzz/$(NAME) fuzz/corpus/$(NAME) -- -max_total_time=300
