#!/bin/sh
# Interruption, at random moments: SIGTERM and --resume give the file of an uninterrupted run; SIGKILL loses what came after the last save and never the
# saved state. Then whether merged runs are worth one long one.
#
#   sh test/kill.sh ./mlt build/main/mlt_saves [KILLS [REPEATS [SECONDS]]]     run from the project's root; 'make kill' builds both programs
#
# mlt_saves is mlt but for one constant: it saves as often as it can, not once a minute, so that many a SIGKILL meets it while it writes.
# KILLS (50) of either kind, some four minutes; then REPEATS (6) times a merge of eight runs of SECONDS (1) against one run of eight times as long, two
# minutes. The last line is 'N passed, N failed'; the merge is reported, not judged.

. "$(dirname "$0")/check.sh"
mlt=$(absolute "$1")
often=$(absolute "$2")
kills=${3:-50}
repeats=${4:-6}
seconds=${5:-1}
scene=$PWD/scenes/cornell.obj
cd "$folder" || exit 1

# moment NUMBER SECONDS: a random share of the seconds, the same for the same number
moment() { awk -v n="$1" -v t="$2" 'BEGIN { srand(n); rand(); printf "%.3f", t * rand() }'; }
clock() { date +%s.%N; }
since() { awk -v then="$1" -v now="$(clock)" 'BEGIN { printf "%.3f", now - then }'; }

# ---- SIGTERM ----

way() { case $(($1 % 4)) in 0) echo ;; 1) echo --direct chain ;; 2) echo --integrator bdpt ;; 3) echo --integrator path ;; esac; }
work() { case $(($1 % 4)) in 2) echo 40 ;; 3) echo 150 ;; *) echo 400 ;; esac; }
for w in 0 1 2 3; do
    begin=$(clock)
    "$mlt" -q -s 48x48 -n "$(work $w)" --bootstrap 20000 $(way $w) -o whole$w.pfm -o whole$w.error.pfm "$scene" || exit 1
    since "$begin" >took$w
done
early=0 late=0 i=0
while [ "$i" -lt "$kills" ]; do
    w=$((i % 4))
    rm -f state
    "$mlt" -q -s 48x48 -n "$(work $w)" --bootstrap 20000 $(way $w) --save state -o part.pfm -o part.error.pfm "$scene" &
    sleep "$(moment "$i" "$(cat took$w)")"
    kill -TERM $! 2>/dev/null || late=$((late + 1))        # done already: resuming must change nothing
    wait $!
    status=$?
    # before it could look for signals there was nothing to be saved
    if [ "$status" -eq 143 ] && [ ! -e state ]; then early=$((early + 1)); i=$((i + 1)); continue; fi
    check "SIGTERM $i: status $status" test "$status" -eq 0
    "$mlt" -q -s 48x48 -n "$(work $w)" --bootstrap 20000 $(way $w) --resume state -o part.pfm -o part.error.pfm "$scene"
    check "SIGTERM $i: resumed" test $? -eq 0
    check "SIGTERM $i: the picture of an uninterrupted run: $(way $w)" cmp -s part.pfm whole$w.pfm
    check "SIGTERM $i: and its error: $(way $w)" cmp -s part.error.pfm whole$w.error.pfm
    i=$((i + 1))
done
check "SIGTERM: $early of $kills before the run had begun, so that little is tested" test $((2 * early)) -le "$kills"
check 'SIGTERM: no temporary files' test -z "$(find . -name '*.tmp*')"
echo "SIGTERM at $kills moments: $early before the run had begun, $late after its end, all others went on to the same files"

# ---- SIGKILL ----

rm -f state
set -- -q -s 256x256 -n 40 --bootstrap 20000
"$mlt" "$@" -o whole.pfm "$scene" || exit 1
i=0 before=0 torn=0 ends=0 oldest=0 found=0
while [ "$i" -lt "$kills" ]; do
    resume=
    [ ! -e state ] || resume='--resume state'
    "$often" "$@" --save state $resume -o part.pfm "$scene" &
    sleep "$(moment "$((1000 + i))" 1.2)"
    age=
    [ ! -e state ] || age=$(since "$(date -r state +%s.%N)")
    if kill -KILL $! 2>/dev/null; then killed=yes; else killed=; fi
    wait $! 2>/dev/null
    status=$?
    if [ -z "$killed" ] || [ "$status" -eq 0 ]; then
        # it came to its end first
        check "SIGKILL $i: the run ends well, status $status" test "$status" -eq 0
        check "SIGKILL $i: the picture of an uninterrupted run" cmp -s part.pfm whole.pfm
        rm -f state
        before=0
        ends=$((ends + 1))
        continue
    fi
    i=$((i + 1))
    [ ! -e state.tmp ] || torn=$((torn + 1))
    if [ ! -e state ]; then
        check "SIGKILL $i: a state that was there is there" test "$before" -eq 0
        continue
    fi
    found=$((found + 1))
    # of pilots alone there is nothing to merge yet, which says that they were read
    "$mlt" merge -v -o part.pfm state 2>said || grep -q 'is left out' said
    check "SIGKILL $i: the state can be read" test $? -eq 0
    done=$(sed -n 's/^1 runs, \([0-9]*\) .*/\1/p' said)
    # a pilot's rounds, a hundredth each, are forgotten
    if [ "$before" -gt $((256 * 256 * 40 / 24)) ]; then check "SIGKILL $i: $done mutations, $before before" test "${done:-0}" -ge "$before"; fi
    before=${done:-0}
    oldest=$(awk -v a="$oldest" -v b="${age:-0}" 'BEGIN { print (b > a ? b : a) }')
done
check "SIGKILL: $found of $kills left a state, so that little is tested" test $((2 * found)) -ge "$kills"
"$often" "$@" --save state $([ ! -e state ] || echo --resume state) -o part.pfm "$scene"
check 'SIGKILL: the last run ends well' test $? -eq 0
check 'SIGKILL: the picture of an uninterrupted run' cmp -s part.pfm whole.pfm
check 'SIGKILL: no half of a state is left by a run that ends well' test ! -e state.tmp
echo "SIGKILL at $kills moments: $torn while the state was written; the state was $oldest s old at most; $((ends + 1)) runs came to their end, with the right picture"

# ---- merge ----

if [ "$repeats" -gt 0 ]; then
    long=$(awk -v t="$seconds" 'BEGIN { print 8 * t }')
    "$mlt" -q -s 48x48 -t "$((20 + 4 * ${long%.*}))" --seed 9999 --integrator path -o reference.pfm "$scene" || exit 1
    error() { "$mlt" compare "$1" reference.pfm | sed -n 's/^relmse //p'; }
    r=0
    while [ "$r" -lt "$repeats" ]; do
        for i in 1 2 3 4 5 6 7 8; do "$mlt" -q -s 48x48 -t "$seconds" --seed $((100 * r + i)) --save "run$i" -o part.pfm "$scene" || exit 1; done
        "$mlt" merge -o merged.pfm run1 run2 run3 run4 run5 run6 run7 run8 || exit 1
        "$mlt" -q -s 48x48 -t "$long" --seed $((100 * r + 9)) -o one.pfm "$scene" || exit 1
        echo "$(error merged.pfm) $(error one.pfm)"
        r=$((r + 1))
    done | awk -v t="$seconds" '{ n++; a += $1; aa += $1 * $1; b += $2; bb += $2 * $2 }
        END {
            va = n > 1 ? (aa - a * a / n) / (n - 1) / n : 0; vb = n > 1 ? (bb - b * b / n) / (n - 1) / n : 0
            if (va < 0) va = 0; if (vb < 0) vb = 0
            printf "relMSE of 8 merged runs of %g s: %.3g +- %.1g; of one run of %g s: %.3g +- %.1g; difference in standard errors %.1f\n",
                t, a / n, sqrt(va), 8 * t, b / n, sqrt(vb), (va + vb > 0 ? (a - b) / n / sqrt(va + vb) : 0)
        }'
fi
report
