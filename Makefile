# Two commands do everything: `make demo` and `make test`. Each installs what is missing first.

PROFILE_DIR := $(or $(CARGO_TARGET_DIR),target)/debug
EFFIGY := $(PROFILE_DIR)/effigy

.PHONY: demo test test-lpips torture fuzz results setup setup-tests build lint body openapi validate-glb

## The main job for real: server, upload, fit, avatar, renders. CLIP=folder uses your own clip.
demo: setup build
	scripts/demo.sh "$(EFFIGY)"

## Formatting, lints, all tests.
test: setup-tests
	scripts/test.sh

## The paper's claims, measured: every study, then docs/results.md.
results: body
	"$(EFFIGY)" study all

## The service under attack, for longer than `make test` does it.
torture: setup build
	EFFIGY_TORTURE_CASES=2000 cargo test --locked --lib every_history_keeps_the_rules
	EFFIGY_TORTURE_CYCLES=200 EFFIGY_TORTURE_JOBS=10000 cargo test --locked --test it service::torture -- --nocapture
	EFFIGY_TORTURE_FIT_KILLS=6 cargo test --locked --test it service::resume -- --nocapture
	EFFIGY_TORTURE_CALLS=1000 EFFIGY_TORTURE_CALL_SECS=20 EFFIGY_TORTURE_SLOW_SECS=60 \
		cargo test --locked --test it service::load -- --nocapture --test-threads=1
	EFFIGY_TORTURE_UPLOAD_MB=2048 EFFIGY_TORTURE_CUTS=200 \
		cargo test --locked --test it an_upload_survives_cuts_and_restarts -- --nocapture
	EFFIGY_TORTURE_MUTATIONS=20000 cargo test --locked --test it fuzz:: -- --nocapture
	@echo 'Fuzzing with coverage, ten minutes for each parser: make fuzz'
	scripts/schemathesis.sh "$(EFFIGY)"
	EFFIGY_TORTURE_STREAMS=5000 cargo test --locked --test it service::hostile::corrupted -- --nocapture

## Every parser under cargo-fuzz, FUZZ_SECS seconds each; what it finds goes into fuzz/corpus, which `make test` runs.
## Needs a nightly toolchain and `cargo install cargo-fuzz --locked`. FUZZ="npz body" runs these parsers alone.
FUZZ_SECS := 600
fuzz:
	scripts/fuzz.sh $(FUZZ_SECS) $(FUZZ)

## Lints and tests of the optional feature: LPIPS by a network that the user gives.
test-lpips: setup-tests
	cargo clippy --locked --all-targets --features lpips -- -D warnings
	cargo test --locked --lib --features lpips eval::lpips

## Installs the packages that are missing (FFmpeg, a Vulkan driver, a C compiler, pip, CA certificates).
setup:
	scripts/setup.sh

## The same, and what the tests want besides (Node.js, rustfmt, clippy).
setup-tests:
	scripts/setup.sh tests

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
	npm ci --prefix tools/gltf-validate --no-audit --no-fund --prefer-offline --loglevel=error
	node tools/gltf-validate/validate.mjs "$(FILE)"
