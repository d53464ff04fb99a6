# Two commands do everything: `make demo` and `make test`. Each installs what is missing first.

PROFILE_DIR := $(or $(CARGO_TARGET_DIR),target)/debug
EFFIGY := $(PROFILE_DIR)/effigy

.PHONY: demo test test-lpips torture results setup build lint body openapi validate-glb

## The main job for real: server, upload, fit, avatar, renders. CLIP=folder uses your own clip.
demo: setup build
	scripts/demo.sh "$(EFFIGY)"

## Formatting, lints, all tests.
test: setup
	scripts/test.sh

## The paper's claims, measured: every study, then docs/results.md.
results: body
	"$(EFFIGY)" study all

## The service under attack, for longer than `make test` does it.
torture: setup
	EFFIGY_TORTURE_CASES=2000 cargo test --locked --lib every_history_keeps_the_rules
	EFFIGY_TORTURE_CYCLES=200 EFFIGY_TORTURE_JOBS=10000 cargo test --locked --test it service::torture -- --nocapture
	cargo test --locked --test it service::resume -- --include-ignored --nocapture
	EFFIGY_TORTURE_STREAMS=5000 cargo test --locked --test it service::hostile::corrupted -- --nocapture

## Lints and tests of the optional feature: LPIPS by a network that the user gives.
test-lpips: setup
	cargo clippy --locked --all-targets --features lpips -- -D warnings
	cargo test --locked --lib --features lpips eval::lpips

## Installs the packages that are missing (FFmpeg, a Vulkan driver, a C compiler, pip, Node.js, CA certificates).
setup:
	scripts/setup.sh

build:
	cargo build --locked

## The default body: downloads its wheel with pip, checks the hash, imports it into the data folder.
body: setup build
	scripts/body.sh "$(EFFIGY)"

lint:
	cargo fmt --check
	cargo clippy --locked --all-targets -- -D warnings

## Writes openapi.yaml anew from the handlers.
openapi: build
	"$(EFFIGY)" openapi > openapi.yaml

## The Khronos validator on a file: make validate-glb FILE=demo-out/avatar.glb
validate-glb:
	npm ci --prefix tools/gltf-validate --no-audit --no-fund --silent
	node tools/gltf-validate/validate.mjs "$(FILE)"
