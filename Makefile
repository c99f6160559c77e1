# mlt: Metropolis light transport in plain C. Needs a C11 compiler and make, nothing else.
#
#   make             the program ./mlt, optimised for this machine
#   make ARCH=       a portable binary
#   make SAN=1       with address and undefined-behaviour sanitizers (in a build folder of its own; the program is ./mlt all the same)
#   make demo        renders a shipped scene
#   make test        proves it right: a few minutes
#   make stress      scenes that break renderers, three estimators in agreement: some minutes
#   make docs-figures  the pictures of README and doc/
#   make kill        interrupts runs at random moments: seven minutes
#   make drift       one chain of 1e9 mutations: nine minutes
#   make bench       speed of ray queries, error against time, cost against size
#   make install     PREFIX=/usr/local, DESTDIR=

CFLAGS ?= -O3
ARCH ?= -march=native
PREFIX ?= /usr/local
# Not for the user to change: the language, and arithmetic as written (a fused multiply-add in a product that two triangles share would open
# the seam between them). math-errno and trapping-math are promises not to read errno and floating-point flags, which no code here does.
MUST = -std=c11 -D_POSIX_C_SOURCE=200809L -ffp-contract=off -fno-math-errno -fno-trapping-math
WARN = -Wall -Wextra -Wpedantic -Wshadow -Wconversion
BUILD = build/main
ifdef SAN
  CFLAGS = -O1 -g -fno-omit-frame-pointer
  MUST += -fsanitize=address,undefined,float-cast-overflow -fno-sanitize-recover=all
  BUILD = build/san
endif
COMPILE = $(CC) $(CPPFLAGS) $(CFLAGS) $(ARCH) $(MUST) $(WARN) -I.

PARTS = $(filter-out main,$(basename $(wildcard *.c)))
OBJECTS = $(PARTS:%=$(BUILD)/%.o)
TESTS = $(patsubst test/%.c,%,$(wildcard test/test_*.c))

mlt: $(BUILD)/mlt
	cp $< $@

$(BUILD)/mlt: $(BUILD)/main.o $(OBJECTS)
	$(COMPILE) $(LDFLAGS) $^ -o $@ -lm

$(BUILD)/%.o: %.c Makefile
	@mkdir -p $(@D)
	$(COMPILE) -MMD -MP -c $< -o $@

$(BUILD)/%.o: test/%.c Makefile
	@mkdir -p $(@D)
	$(COMPILE) -Itest -MMD -MP -c $< -o $@

$(BUILD)/test_%: $(BUILD)/test_%.o $(OBJECTS)
	$(COMPILE) $(LDFLAGS) $^ -o $@ -lm

-include $(wildcard $(BUILD)/*.d)

# Everything is proved here; the runner closes with 'N passed, N failed'. To run one: make build/main/test_bvh && build/main/test_bvh
test: mlt $(TESTS:%=$(BUILD)/%) $(BUILD)/drift $(BUILD)/metropolis1d $(BUILD)/fuzz_obj $(BUILD)/fuzz_image
	@sh test/run.sh $(TESTS:%=$(BUILD)/%) '$(BUILD)/drift 3e6' $(BUILD)/metropolis1d \
	    '$(BUILD)/fuzz_obj test/corpus/obj/* && echo 1 passed, 0 failed' '$(BUILD)/fuzz_image test/corpus/image/* && echo 1 passed, 0 failed' \
	    'sh test/test_cli.sh ./mlt' 'sh test/test_explain.sh ./mlt' 'sh test/test_docs.sh ./mlt'

# Some fifty scenes that break renderers (degenerate meshes, extreme sizes, materials and cameras): path, bdpt and mlt agree, and nothing is
# NaN. After a change to anything that traces, scatters or samples.
stress: $(BUILD)/stress
	$(BUILD)/stress

$(BUILD)/stress: $(BUILD)/stress.o $(OBJECTS)
	$(COMPILE) $(LDFLAGS) $^ -o $@ -lm

# One long chain: what its states have cached against the same from scratch, and its light against independent samples. Nine minutes;
# build/main/drift MUTATIONS for another length.
drift: $(BUILD)/drift
	$(BUILD)/drift

$(BUILD)/drift: $(BUILD)/drift.o $(OBJECTS)
	$(COMPILE) $(LDFLAGS) $^ -o $@ -lm

# Interruption at random moments, and whether merged runs are worth one long one: seven minutes. mlt_saves saves at every look at the clock.
kill: mlt $(BUILD)/mlt_saves
	sh test/kill.sh ./mlt $(BUILD)/mlt_saves

$(BUILD)/main_saves.c: main.c
	@mkdir -p $(@D)
	sed 's/SAVE_SECONDS = 60/SAVE_SECONDS = 0/' main.c >$@ && grep -q 'SAVE_SECONDS = 0' $@

$(BUILD)/mlt_saves: $(BUILD)/main_saves.c $(OBJECTS)
	$(COMPILE) $(LDFLAGS) $^ -o $@ -lm

# Reports only; one part at a time: bench-rays (million rays a second), bench-error (error against time: 25 minutes), bench-cost (a mutation, and the
# tree, against triangles and path length), bench-ways (error with one strategy left out at a time: 20 minutes).
bench: mlt
	$(MAKE) bench-rays
	$(MAKE) bench-error
	$(MAKE) bench-cost

bench-rays: $(BUILD)/bench_rays
	$(BUILD)/bench_rays

bench-error: mlt $(BUILD)/bench_plot
	sh test/bench_error.sh ./mlt

bench-ways: mlt $(BUILD)/bench_plot
	sh test/bench_error.sh ./mlt 3

# Estimated over true error: an hour.
bench-estimate: mlt
	sh test/bench_estimate.sh ./mlt

# Whether pictures of different seeds differ by no more than each says of itself: twenty minutes.
bench-seeds: $(BUILD)/bench_seeds
	$(BUILD)/bench_seeds scenes/cornell.obj scenes/glossy.obj scenes/door.obj scenes/caustic.obj scenes/pool.obj

bench-cost: $(BUILD)/bench_cost
	@mkdir -p build/bench
	$(BUILD)/bench_cost build/bench

$(BUILD)/bench_%: $(BUILD)/bench_%.o $(BUILD)/svgplot.o $(OBJECTS)
	$(COMPILE) $(LDFLAGS) $^ -o $@ -lm

$(BUILD)/fuzz_%: $(BUILD)/fuzz_%.o $(OBJECTS)
	$(COMPILE) $(LDFLAGS) $^ -o $@ -lm

$(BUILD)/metropolis1d: $(BUILD)/metropolis1d.o $(BUILD)/svgplot.o
	$(COMPILE) $(LDFLAGS) $^ -o $@ -lm

$(BUILD)/trace: $(BUILD)/trace.o $(BUILD)/svgplot.o $(OBJECTS)
	$(COMPILE) $(LDFLAGS) $^ -o $@ -lm

$(BUILD)/wrong: $(BUILD)/wrong.o $(OBJECTS)
	$(COMPILE) $(LDFLAGS) $^ -o $@ -lm

# The figures of doc/, drawn again.
docs-figures: mlt $(BUILD)/wrong $(BUILD)/metropolis1d $(BUILD)/trace
	$(CC) doc/figures.c -o $(BUILD)/figures && $(BUILD)/figures doc/figures
	$(BUILD)/metropolis1d --svg doc/figures/metropolis1d.svg
	$(BUILD)/wrong doc/figures
	$(BUILD)/trace doc/figures
	for s in '30 400x300 caustic' '30 320x240 pool' '20 320x240 door' '20 240x240 cornell' '20 360x240 glossy'; do \
	    set -- $$s; ./mlt -q -t $$1 -s $$2 -o doc/figures/$$3.png scenes/$$3.obj; done

# A picture in half a minute: look at the bright caustic under the glass ball.
demo: mlt
	./mlt -t 30 -o caustic.png scenes/caustic.obj
	@echo 'caustic.png: the light that the glass ball gathers on the floor'

install: mlt
	mkdir -p $(DESTDIR)$(PREFIX)/bin
	cp mlt $(DESTDIR)$(PREFIX)/bin/mlt

clean:
	rm -rf build mlt

.SECONDARY:

.PHONY: test demo bench stress kill drift bench-rays bench-error bench-estimate bench-cost bench-ways bench-seeds docs-figures install clean
