#!/bin/sh
# The program as its users meet it: wrong usage, files that cannot be used, what is written and what is not, signals, counters.
#
#   sh test/test_cli.sh [PROGRAM]      ./mlt if none is given
#
# Tiny scenes in a folder of its own, which is removed. Says nothing about the pictures' correctness; other tests do.
# The last line is 'N passed, N failed'; the status is 1 if anything failed.

. "$(dirname "$0")/check.sh"
mlt=$(absolute "${1:-./mlt}")
shipped=$PWD/scenes                                    # the caller is at the project's root
cd "$folder" || exit 1

# run ARGUMENT...: leaves status, and the two streams in files
run() { "$mlt" "$@" >"$folder/stdout" 2>"$folder/stderr"; status=$?; }

# expect STATUS ARGUMENT...
expect()
{
    wanted=$1
    shift
    run "$@"
    check "status $status, not $wanted: mlt $*" test "$status" -eq "$wanted"
}

# sweep: empties the folder 'out'
sweep()
{
    left=$left$(find out -name '*.tmp*')
    rm -f out/*
}
left=
silent() { test ! -s stdout && test ! -s stderr; }
# only_files NAME...: the files in the folder 'out'
only_files() { test "$(cd out && ls | tr '\n' ' ')" = "$(for f; do printf '%s ' "$f"; done)"; }
# all_zero FILE COUNT: the last COUNT bytes
all_zero() { test -s "$1" && test "$(tail -c "$2" "$1" | tr -d '\000' | wc -c)" -eq 0; }
bytes() { wc -c <"$1" | tr -d ' '; }

# ---- scenes ----

cat >room.mtl <<'END'
newmtl white
Kd 0.7 0.6 0.5
newmtl lamp
Kd 0 0 0
Ke 9 8 7
END
cat >room.obj <<'END'
mtllib room.mtl
v -1 0 -1
v -1 0 1
v 1 0 1
v 1 0 -1
v -1 2 -1
v 1 2 -1
v -0.3 1.9 -0.3
v 0.3 1.9 -0.3
v 0.3 1.9 0.3
v -0.3 1.9 0.3
usemtl white
f 1 2 3 4
f 1 4 6 5
usemtl lamp
f 7 8 9 10
END
cat >room.cam <<'END'
eye 0 1 4
look 0 0.9 0
fov 40
size 24 16
END
cat >mirrors.mtl <<'END'
newmtl mirror
illum 3
Ks 0.9 0.9 0.9
END
cat room.mtl >>mirrors.mtl
# a small lamp over a table in a room of mirrors
cat >mirrors.obj <<'END'
mtllib mirrors.mtl
v -1 0 -1
v -1 0 1
v 1 0 1
v 1 0 -1
v -1 2 -1
v -1 2 1
v 1 2 1
v 1 2 -1
v -0.1 1.9 -0.1
v 0.1 1.9 -0.1
v 0.1 1.9 0.1
v -0.1 1.9 0.1
v -0.4 0.6 -0.4
v -0.4 0.6 0.4
v 0.4 0.6 0.4
v 0.4 0.6 -0.4
usemtl mirror
f 1 2 3 4
f 5 8 7 6
f 1 4 8 5
f 2 6 7 3
f 1 5 6 2
f 4 3 7 8
usemtl lamp
f 9 10 11 12
usemtl white
f 13 14 15 16
END
printf 'eye 0 1.2 0.9\nlook 0 0.8 -1\nfov 60\nsize 24 16\n' >mirrors.cam
sed '/usemtl lamp/,$d' room.obj >dark.obj              # no light
cp room.obj blind.obj                                  # a light that the camera cannot see: all is behind it
printf 'eye 0 1 4\nlook 0 1 9\nsize 24 16\n' >blind.cam
cp room.cam dark.cam
printf 'v 0 0 0\nv 1 0 0\n' >faceless.obj
printf 'v 0 0 0\nv 1 0 zero\nv 0 1 0\nf 1 2 3\n' >broken.obj
cp room.obj badcam.obj
printf 'eye 0 0 1\nfov 200\n' >badcam.cam
mkdir out
short='-q -n 4 --bootstrap 500'

# ---- wrong usage: status 2, a hint, nothing on standard output, nothing written ----

usage()
{
    expect 2 "$@"
    check "hint for: mlt $*" grep -q -- '--help' stderr
    check "message for: mlt $*" grep -q '^mlt: ' stderr
    check "nothing on standard output: mlt $*" test ! -s stdout
}

touch stdout stderr
there=$(ls)
usage
usage --nonsense room.obj
usage -z room.obj
usage -qz room.obj
usage room.obj dark.obj
usage room.obj -n
usage room.obj -o
usage room.obj --quiet=1
usage room.obj -o picture.exr
usage room.obj -o picture
usage room.obj -o ''
usage room.obj --stats ''
for value in 0 -1 x '' 4x ' 4' nan inf 1e999 1,5; do
    usage room.obj -n "$value"
    usage room.obj "--time=$value"
    usage room.obj -e "$value"
done
for value in 12 12x x12 12x12x12 0x12 12x0 1.5x12 -1x12 65536x1 65535x65535 12X12 '12 x12'; do usage room.obj -s "$value"; done
for value in 1,2 1,2,3,4 1,2, ,1,2 1,2,x 1:2:3 ''; do usage room.obj --eye "$value"; done
usage room.obj --up 0,0,0
usage room.obj --fov 0
usage room.obj --fov 180
usage room.obj --aperture -1
usage room.obj --focus 0
for value in -1 1.5 x 1e300; do usage room.obj --seed "$value"; done
for value in 0 256 2.5 x; do usage room.obj --max-depth "$value"; done
for value in 0 -5 1.5 x; do
    usage room.obj --chains "$value"
    usage room.obj --bootstrap "$value"
done
for value in '' nonsense bidir,nonsense bidir, ,bidir bidir,,lens Bidir; do usage room.obj --strategies "$value"; done
usage room.obj --integrator nonsense
usage room.obj --integrator pat
usage room.obj --direct nonsense
usage room.obj --exposure bright
usage merge
usage merge one.run
usage merge -o out/x.pfm
usage compare
usage compare one.pfm
usage compare one.pfm two.pfm three.pfm
usage compare --nonsense one.pfm two.pfm
check 'wrong usage writes nothing' test "$(ls)" = "$there"

# ---- help and version ----

expect 0 --help
check 'help says nothing on standard error' test ! -s stderr
for option in output size eye look up fov aperture focus mutations time error seed integrator strategies direct max-depth bootstrap chains \
              exposure save resume stats quiet verbose help version; do
    check "help names --$option" grep -q -- "--$option" stdout
done
for word in compare bidir,lens,caustic,chain,subpath,manifold bdpt apart; do check "help names $word" grep -q -- "$word" stdout; done
for command in '' compare merge explain; do
    expect 0 $command --version
    check "version: $command" grep -qx 'mlt [0-9.]*' stdout
done

# ---- files that cannot be used: status 1, the file named, nothing written ----

unusable()
{
    name=$1
    shift
    expect 1 "$@" -o out/x.pfm
    check "'$name' in the message of: mlt $*" grep -q "^mlt: .*$name" stderr
    check "nothing written by: mlt $*" only_files
}
unusable nowhere.obj nowhere.obj
unusable faceless.obj faceless.obj
unusable broken.obj:2 broken.obj
unusable badcam.cam:2 badcam.obj
unusable out out
unusable room.obj room.obj --eye 1,1,1 --look 1,1,1
echo before >out/kept.pfm
expect 1 broken.obj -o out/kept.pfm
check 'a failed run leaves the old file' grep -qx before out/kept.pfm
rm out/kept.pfm

# A place that cannot be written is found before the run, and nothing else is written either.
start=$(date +%s)
mkdir out/folder.ppm
expect 1 room.obj -t 60 -o out/x.pfm -o nowhere/y.pfm
check 'the place is named' grep -q nowhere/y.pfm stderr
expect 1 room.obj -t 60 -o out/x.pfm -o out/folder.ppm
expect 1 room.obj -t 60 -o out/x.pfm --stats nowhere/stats.json
check 'places are tried before the run' test $(($(date +%s) - start)) -lt 20
rmdir out/folder.ppm
check 'nothing is written if one place is bad' only_files

# A disk that fills up: the old file stays, and no half of a new one.
echo before >out/kept.pfm
(trap '' XFSZ && ulimit -f 4 && "$mlt" room.obj $short -s 64x64 -o out/kept.pfm) >stdout 2>stderr
check 'no room: status 1' test $? -eq 1
check 'no room: says so' grep -q '^mlt: .*kept.pfm' stderr
check 'no room: the old file stays' grep -qx before out/kept.pfm
check 'no room: no half' only_files kept.pfm
rm out/kept.pfm

# Too little memory is an error, no crash. (Skipped where a program cannot start in so little, as under sanitizers.)
if (ulimit -v 400000 && "$mlt" --version; exit $?) >/dev/null 2>&1; then
    (ulimit -v 400000 && "$mlt" room.obj $short -s 16000x16000 -o out/x.pfm) >stdout 2>stderr
    check 'no memory: status 1' test $? -eq 1
    check 'no memory: says so' grep -q 'mlt: .*memory' stderr
    check 'no memory: nothing written' only_files
fi

# ---- what is written ----

mkdir scenes
cp room.* scenes
(cd out && "$mlt" ../scenes/room.obj $short) >stdout 2>stderr
check 'a run with default outputs' test $? -eq 0
check 'NAME.pfm and NAME.ppm in the current folder, and nothing else' only_files room.pfm room.ppm
check 'not a word when all is well' silent
check 'PFM: colour, size of NAME.cam' test "$(head -n 3 out/room.pfm | tr '\n' ' ')" = "PF 24 16 $(sed -n 3p out/room.pfm) "
check 'PFM: little endian, scale 1' test "$(sed -n 3p out/room.pfm | awk '{ print $1 + 0 }')" = -1
check 'PFM: all values' test "$(bytes out/room.pfm)" -eq $((12 * 24 * 16 + $(head -n 3 out/room.pfm | wc -c)))
check 'PFM: not black' not all_zero out/room.pfm $((12 * 24 * 16))
check 'PPM: header' test "$(head -n 3 out/room.ppm | tr '\n' ' ')" = 'P6 24 16 255 '
sweep

expect 0 $short -oout/a.pfm --output=out/b.pfm -o out/c.PPM --output out/d.png room.obj -o out/e.error.pfm
check 'every -o, and no default output' only_files a.pfm b.pfm c.PPM d.png e.error.pfm
check 'the same picture twice' cmp out/a.pfm out/b.pfm
check 'PNG: signature' test "$(head -c 8 out/d.png | od -An -tx1 | tr -d ' \n')" = 89504e470d0a1a0a
check 'the standard error is another picture' differ out/a.pfm out/e.error.pfm
check 'the standard error has the same size' test "$(bytes out/a.pfm)" -eq "$(bytes out/e.error.pfm)"
cp out/a.pfm first.pfm
sweep

expect 0 $short -o out/a.pfm -- room.obj
check 'options before, and --' cmp out/a.pfm first.pfm
cp room.obj ./-dash.obj && cp room.cam ./-dash.cam
expect 0 $short -o out/a.pfm -- -dash.obj
check 'a scene that begins with a dash' cmp out/a.pfm first.pfm

expect 0 room.obj $short -s 7x5 -o out/a.pfm
check 'size on the command line wins' grep -aqx '7 5' out/a.pfm
expect 0 room.obj $short --size=1x1 -o out/a.pfm
check 'one pixel' grep -aqx '1 1' out/a.pfm
expect 0 room.obj $short --eye -1,1,4 --look 0,1,0 --up=0,0,1 --fov 50 --aperture 0.1 --focus 4 -o out/a.pfm
check 'the camera on the command line wins' differ out/a.pfm first.pfm
expect 0 room.obj $short -o out/a.pfm -o out/a.ppm
expect 0 room.obj $short --exposure 1 -o out/b.pfm -o out/b.ppm
check 'exposure leaves .pfm alone' cmp out/a.pfm out/b.pfm
check 'exposure changes .ppm' differ out/a.ppm out/b.ppm
sweep

# ---- the same seed: the same bits ----

for options in '' '--integrator bdpt' '--integrator path' '--direct chain' '--direct only' '--direct none' '--strategies bidir,lens --chains 50 --max-depth 5'; do
    expect 0 room.obj $short $options -o out/a.pfm
    expect 0 $short $options --seed 1 -o out/b.pfm room.obj
    expect 0 room.obj $short $options --seed 2 -o out/c.pfm
    check "seed 1 is the default, and gives the same file: $options" cmp out/a.pfm out/b.pfm
    check "seed 2 gives another file: $options" differ out/a.pfm out/c.pfm
done
sweep

# ---- limits ----

# between LOW HIGH VALUE
between() { awk -v low="$1" -v high="$2" -v value="$3" 'BEGIN { exit !(value != "" && value >= low && value <= high) }'; }
# said KEY: a number that mlt compare has printed
said() { sed -n "s/^$1 //p" stdout; }
# value KEY FILE: of a number in a statistics file
value() { sed -n "s/^ *\"$1\": \([^,]*\),*\$/\1/p" "$2"; }

for options in '' '--integrator path' '--integrator bdpt'; do
    start=$(date +%s)
    expect 0 room.obj -q -s 4x4 -t 2 $options --stats out/stats -o out/a.pfm
    took=$(($(date +%s) - start))
    check "-t 2 took $took s: $options" between 1 5 "$took"
    check "-t 2 is used up, as it lifts the default -n: $options" between 1.5 4 "$(value seconds_total out/stats)"
done
expect 0 room.obj -q -t 30 -n 4 --bootstrap 500 --stats out/stats -o out/a.pfm
check '-n before -t' between 0 20 "$(value seconds_total out/stats)"
for options in '' '--integrator path' '--integrator bdpt'; do
    expect 0 room.obj -q -e 0.3 -t 30 --bootstrap 5000 $options --stats out/stats -o out/a.pfm
    check "-e before -t: $options" between 0 20 "$(value seconds_total out/stats)"
    check "-e is reached: $options" between 0 0.3 "$(value estimated_relative_error out/stats)"
done
# As many chains as are asked for: one, of which no error is known.
expect 0 room.obj -q -n 400 --direct chain --chains 1 --stats out/stats -o out/a.pfm
check '--chains 1: no error is known' test "$(value estimated_relative_error out/stats)" = null
check '--chains 1: all mutations' between 400 400 "$(awk "BEGIN { print $(value mutations out/stats) / $(value width out/stats) / $(value height out/stats) }")"
expect 0 room.obj -q -n 400 --direct chain --chains 3 --stats out/stats -o out/a.pfm
check '--chains 3: an error is known' between 0 2 "$(value estimated_relative_error out/stats)"
sweep

# ---- units and origin: neither is to be seen in the picture ----

# moved NAME FACTOR X Y Z [DIGITS]: room.obj and its camera, multiplied and moved, as NAME.obj and NAME.cam, in all the digits of a double
moved()
{
    for ending in obj cam; do
        awk -v s="$2" -v x="$3" -v y="$4" -v z="$5" -v f="%s %.${6:-17}g %.${6:-17}g %.${6:-17}g\n" '
            $1 == "v" || $1 == "eye" || $1 == "look" { printf f, $1, $2 * s + x, $3 * s + y, $4 * s + z; next }
            $1 == "focus" || $1 == "aperture" { printf "%s %.17g\n", $1, $2 * s; next }
            { print }' room.$ending >"$1.$ending"
    done
}

echo 'focus 3.7' >>room.cam
echo 'aperture 0.03' >>room.cam
moved large 1024 0 0 0
moved tiny 0.00000095367431640625 0 0 0                # 2^-20
moved odd 1.1 0 0 0
for options in '' '--integrator bdpt' '--integrator path'; do
    expect 0 room.obj $short $options -o out/a.pfm
    for name in large tiny; do
        expect 0 $name.obj $short $options -o out/b.pfm
        check "the same bits in a unit smaller or larger by a power of two: $name $options" cmp out/a.pfm out/b.pfm
    done
    expect 0 odd.obj $short $options -o out/b.pfm
    check "and not in any unit: $options" differ out/a.pfm out/b.pfm
done

# Moved by so much that no digit is lost, which takes coordinates of few bits, it is the same scene.
cp room.obj kept.obj && cp room.cam kept.cam
sed 's/0\.3/0.25/g; s/1\.9/1.875/g' kept.obj >room.obj
sed 's/0\.9/0.875/; s/3\.7/3.75/; s/0\.03/0.03125/' kept.cam >room.cam
moved far 1 2097152 -1048576 4194304                   # 2^21, 2^20, 2^22: the room is 2 wide
for options in '' '--integrator bdpt' '--integrator path'; do
    expect 0 room.obj $short $options -o out/a.pfm
    expect 0 far.obj $short $options -o out/b.pfm
    check "the same bits far from the origin: $options" cmp out/a.pfm out/b.pfm
done
mv kept.obj room.obj && mv kept.cam room.cam
# Where digits are lost, paths may go elsewhere by and by: the same picture but for noise. What is lost is below 1e-9 of the room, which is
# less than what the program itself keeps of a position, so that hardly any path does.
moved far 1 2000000.1 -1000000.3 3000000.7
moved coarse 1 2000000.1 -1000000.3 3000000.7 7        # to whole units: what is left is no room
for options in '-n 400 --bootstrap 20000' '-n 100 --integrator bdpt' '-n 200 --integrator path'; do
    expect 0 room.obj -q $options -o out/a.pfm
    expect 0 far.obj -q $options -o out/b.pfm
    expect 0 compare out/a.pfm out/b.pfm
    check "the same mean a million sizes from the origin: $options" between 0.98 1.02 "$(said ratio_of_means)"
    check "the same picture a million sizes from the origin: $options" between 0 0.02 "$(said relmse)"
    expect 0 coarse.obj -q $options -o out/b.pfm
    expect 0 compare out/b.pfm out/a.pfm                # which is black, and no reference
    check "another picture if digits are left out: $options" between 0.02 1e30 "$(said relmse)"
done
sed '/focus/d; /aperture/d' room.cam >kept.cam && mv kept.cam room.cam
sweep

# ---- signals ----

for signal in TERM INT; do
    for options in '' '--integrator path'; do
        "$mlt" room.obj -t 60 $options -o out/a.pfm -o out/a.ppm --stats out/stats >stdout 2>stderr &
        sleep 1
        kill -$signal $!
        wait $!
        check "SIG$signal: status 0: $options" test $? -eq 0
        check "SIG$signal: all files: $options" only_files a.pfm a.ppm stats
        check "SIG$signal: a whole picture: $options" test "$(bytes out/a.pfm)" -eq "$(bytes first.pfm)"
        check "SIG$signal: not black: $options" not all_zero out/a.pfm $((12 * 24 * 16))
        check "SIG$signal: at once: $options" between 0 20 "$(value seconds_total out/stats)"
        sweep
    done
done

# ---- runs on file ----

# Interrupted three times and gone on with: the file of an uninterrupted run. (test/kill.sh does that at many random moments.)
long='-q -n 4000 --bootstrap 2000 -o out/a.pfm -o out/a.error.pfm'
expect 0 room.obj $long
mv out/a.pfm whole.pfm
mv out/a.error.pfm whole.error.pfm
resume=
for wait in 0.1 0.3 0.2 1; do
    if [ $wait = 1 ] && [ -n "$resume" ]; then break; fi
    "$mlt" room.obj $long --save out/state $resume >stdout 2>stderr &
    sleep $wait 2>/dev/null || sleep 1
    kill -TERM $! 2>/dev/null               # a fast machine may have finished
    wait $!
    # killed before it could look for signals: nothing had been done
    status=$?
    if [ $status -eq 143 ]; then status=0; fi
    check "--save, interrupted: status $status" test $status -eq 0
    [ ! -e out/state ] || resume='--resume out/state'
done
check '--save: an interrupted run leaves a state' test -n "$resume"
expect 0 room.obj $long --save out/state $resume
check '--resume: the picture of an uninterrupted run' cmp out/a.pfm whole.pfm
check '--resume: and its standard error' cmp out/a.error.pfm whole.error.pfm
check '--resume: no other files' only_files a.error.pfm a.pfm state
for options in '' '--direct chain' '--integrator path' '--integrator bdpt'; do
    expect 0 room.obj $short $options --save out/done -o out/a.pfm
    expect 0 room.obj $short $options --save out/done --resume out/done -o out/b.pfm
    expect 0 room.obj $short $options --resume out/done -o out/c.pfm
    check "a run that was done stays as it was: $options" cmp out/a.pfm out/b.pfm
    check "and again: $options" cmp out/a.pfm out/c.pfm
done
# What was done can be had longer: exactly as much as asked for, and a better picture.
for options in '' '--direct chain' '--integrator path'; do
    expect 0 room.obj -q -n 40 $options --save out/done -o out/a.pfm
    expect 0 room.obj -q -n 4000 $options --resume out/done --stats out/stats -o out/b.pfm
    wanted=$((4000 * 24 * 16))
    case $options in '--direct chain') check "a run that was done goes on to a larger -n: $options" test "$(value mutations out/stats)" -eq $wanted ;; esac
    expect 0 compare out/b.pfm whole.pfm
    better=$(said relmse)
    expect 0 compare out/a.pfm whole.pfm
    check "and becomes better: $options" between 0 "$(awk "BEGIN { print $(said relmse) / 10 }")" "$better"
done
# In a room of mirrors chains hardly leave their seeds, and some runs leave them nothing (here five of six): what there is can be resumed, and is all of the picture.
expect 0 mirrors.obj -q --integrator path -n 4000 -o mirrors.pfm
kept=0
ratios=0
for seed in 1 2 3 4 5 6; do
    expect 0 mirrors.obj -v -n 100 --seed $seed --save out/done -o out/a.pfm
    grep -q 'keep all light' stderr && kept=$((kept + 1))
    expect 0 mirrors.obj -q -n 100 --seed $seed --resume out/done -o out/b.pfm
    check "resumed, whatever is left to chains: seed $seed" cmp out/a.pfm out/b.pfm
    expect 0 compare out/a.pfm mirrors.pfm
    ratios="$ratios + $(said ratio_of_means)"
done
check "samples keep all light in a room of mirrors: $kept of 6" test $kept -ge 1
check "and lack none: ($ratios) / 6" between 0.93 1.07 "$(awk "BEGIN { print ($ratios) / 6 }")"
rm out/?.pfm out/done out/stats
"$mlt" room.obj $long --save out/state >stdout 2>stderr &
sleep 0.2 2>/dev/null || sleep 1
kill -KILL $!
wait $! 2>/dev/null
expect 0 merge -o out/a.pfm out/state
check 'SIGKILL leaves the old state' cmp out/a.pfm whole.pfm
rm -f out/*                                            # and may leave a temporary file

expect 0 room.obj $short --seed 1 --save out/one -o out/a.pfm
expect 0 room.obj $short --seed 2 --save out/two -o out/a.pfm
expect 0 room.obj $short --seed 3 --max-depth 5 --save out/short -o out/a.pfm
expect 0 dark.obj $short --seed 4 --save out/dark -o out/a.pfm
head -c 5000 out/one >out/half
echo nonsense >out/nonsense
rm out/a.pfm
expect 0 merge -o out/m.pfm -o out/m.png -o out/m.error.pfm out/one out/two
check 'merge: all outputs' test -s out/m.pfm -a -s out/m.png -a -s out/m.error.pfm
expect 0 merge -o out/n.pfm out/two out/one
expect 0 compare out/n.pfm out/m.pfm
check 'merge: the order does not matter' between 0 1e-9 "$(said relmse)"
rm -f out/m.* out/n.*
# A merged picture lies on the line between the two: its distances to them add up to theirs. Each run cuts path space for itself, the first two not alike.
distance() { "$mlt" compare "$1" "$2" | sed -n 's/^rmse //p'; }
for options in '2000' '100 --direct chain' '100 --direct none' '100 --integrator path' '100 --integrator bdpt'; do
    set -- $options
    many=$1
    shift
    expect 0 room.obj -q -n $((many / 20)) "$@" --seed 1 --save out/few -o out/a.pfm
    expect 0 room.obj -q -n $many "$@" --seed 2 --save out/many -o out/b.pfm
    expect 0 merge -o out/m.pfm out/few out/many
    sum=$(awk "BEGIN { print ($(distance out/m.pfm out/a.pfm) + $(distance out/m.pfm out/b.pfm)) / $(distance out/a.pfm out/b.pfm) }")
    check "merge: between the two pictures, $sum: $options" between 0.9999 1.0001 "$sum"
    check "merge: nearer to that of more work: $options" awk "BEGIN { exit !($(distance out/m.pfm out/b.pfm) < $(distance out/m.pfm out/a.pfm)) }"
done
rm -f out/?.pfm out/few out/many
refused()
{
    what=$1
    shift
    expect 1 "$@" -o out/a.pfm
    check "$what: a message, no picture: mlt $*" test -s stderr -a ! -e out/a.pfm
}
refused 'the same seed' merge out/one out/two out/one
refused 'other options' merge out/one out/short
refused 'another scene' merge out/one out/dark
for state in half nonsense nowhere; do
    refused 'no whole state' merge out/two out/$state
    refused 'no whole state' room.obj $short --resume out/$state
done
refused 'another seed' room.obj $short --resume out/two
refused 'another scene' dark.obj $short --resume out/one
refused 'other options' room.obj $short --resume out/one --max-depth 5
sweep

# Texture coordinates are part of the scene.
printf 'newmtl white\nKd 1 1 1\nmap_Kd checks.ppm\nnewmtl lamp\nKe 9 8 7\n' >textured.mtl
printf 'P3 2 2 255 255 0 0 0 255 0 0 0 255 255 255 255\n' >checks.ppm
sed 's/room.mtl/textured.mtl/; s:^f 1 2 3 4:vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3 4/4:' room.obj >textured.obj
sed 's/^vt 1 1/vt 0.5 1/' textured.obj >stretched.obj
sed 's:1/1 2/2 3/3 4/4:1/2 2/3 3/4 4/1:' textured.obj >turned.obj
for name in textured stretched turned; do cp room.cam $name.cam; done
expect 0 textured.obj $short --save out/one -o out/b.pfm
for name in stretched turned; do refused 'other texture coordinates' $name.obj $short --resume out/one; done
sweep

# A byte that is not as it was written, wherever it stands: a message, no picture, no crash. (The run is stopped within a chain, whose path is kept too.)
flip()
{
    byte=$(tail -c +$(($2 + 1)) "$1" | head -c 1 | od -An -tu1 | tr -d ' ')
    { head -c "$2" "$1"; printf "\\$(printf %03o $((byte ^ 16)))"; tail -c +$(($2 + 2)) "$1"; } >"$1.flipped"
}
long='room.obj -q -n 40000 --chains 16 --bootstrap 2000'
"$mlt" $long --save out/one -o out/b.pfm >stdout 2>stderr &
sleep 1
kill -TERM $!
wait $!
check 'an interrupted run is saved' test -s out/one
size=$(bytes out/one)
for at in 0 9 17 30 36 40 44 1000 $((size / 4)) $((size / 2)) $((size * 3 / 4)) $((size - 2000)) $((size - 1200)) $((size - 600)) $((size - 9)) $((size - 1)); do
    flip out/one "$at"
    refused "byte $at of $size" $long --resume out/one.flipped
    check "byte $at of $size: the file in the message" grep -q '^mlt: out/one.flipped: ' stderr
    refused "byte $at of $size" merge out/one.flipped
done
head -c $((size - 8)) out/one >out/half
refused 'no checksum' merge out/half
(cat out/one && echo) >out/half
refused 'too long' merge out/half
expect 0 merge out/one -o out/a.pfm
sweep

# A pipe is never replaced by a file: pictures go through it, and a state, which must be replaced when it is old, is refused.
mkfifo out/pipe out/pipe.pfm
start=$(date +%s)
expect 1 room.obj -t 60 --save out/pipe -o out/a.pfm
check '--save to a pipe: the file in the message' grep -q '^mlt: out/pipe: ' stderr
check '--save to a pipe is refused before the run' test $(($(date +%s) - start)) -lt 20
check '--save to a pipe: it is one still' test -p out/pipe
cat out/pipe.pfm >piped.pfm &
expect 0 room.obj $short -o out/a.pfm -o out/pipe.pfm
check 'a picture to a pipe: it is one still' test -p out/pipe.pfm
if [ -p out/pipe.pfm ]; then wait $!; else kill $!; fi
check 'a picture to a pipe: all of it' cmp out/a.pfm piped.pfm
sweep

# ---- runs that are cut short, shortened or lengthened ----

# Every picture has all of its light, however early it is written: a sample in every pixel comes first.
has_light() { "$mlt" compare "$1" "$2" | awk '/^ratio_of_means/ { ok = $2 > 0.75 && $2 < 1.25 } END { exit !ok }'; }
expect 0 "$shipped/cornell.obj" --integrator path -n 4 -s 256x256 -o out/path.pfm
for seconds in 0.2 1 2; do
    expect 0 "$shipped/cornell.obj" -t $seconds -s 256x256 -o out/a.pfm
    check "light after $seconds s" has_light out/a.pfm out/path.pfm
done
"$mlt" "$shipped/cornell.obj" -q -n 20000 -s 256x256 -o out/a.pfm &
sleep 1
kill -INT $!
wait $!
check 'light of a run interrupted early' has_light out/a.pfm out/path.pfm

# ends SECONDS ARGUMENT...: the run ends by itself
ends()
{
    limit=$1
    shift
    "$mlt" "$@" >stdout 2>stderr &
    for tick in $(seq $((10 * limit))); do
        kill -0 $! 2>/dev/null || break
        sleep 0.1
    done
    ! kill -KILL $! 2>/dev/null
}
run room.obj -n 100 --save out/saved
check 'half of what is there already' ends 30 room.obj -n 50 --resume out/saved
"$mlt" room.obj -q -n 1e7 --save out/saved &
sleep 1
kill -INT $!
wait $!
check 'much less than was begun' ends 30 room.obj -n 20 --resume out/saved
check 'without light there is nothing to wait for' ends 30 dark.obj -n 20 -o out/dark.pfm
check 'the clock before --bootstrap' ends 20 room.obj -t 1 --bootstrap 1e8
"$mlt" room.obj -q -n 10 --bootstrap 1e8 &
start=$(date +%s)
sleep 1
kill -INT $!
wait $!
check 'an interrupted bootstrap' test $(($(date +%s) - start)) -lt 15

expect 0 room.obj -e 0.2 --save out/saved --stats out/before
expect 0 room.obj -n 20000 --resume out/saved --stats out/after
expect 0 room.obj -e 0.2 -o out/once.pfm --save out/saved
expect 0 room.obj -e 0.2 -o out/again.pfm --resume out/saved
check 'a run that has reached its error is done' cmp out/once.pfm out/again.pfm
check 'a run that had reached its error goes on' test "$(value mutations out/after)" -gt "$(value mutations out/before)"

"$mlt" "$shipped/door.obj" -q -t 60 -s 32x32 --save out/saved &
sleep 2
kill -TERM $!
wait $!
expect 0 "$shipped/door.obj" -t 5 -s 32x32 --resume out/saved --stats out/after
check 'chains get their part of a resumed run' test "$(value seconds_chain out/after | cut -d. -f1)" -ge 1
sweep

# ---- counters ----

# Reads JSON as RFC 8259 has it, numbers of which the reader could not make sense included; silent if it is well-formed.
cat >json.awk <<'END'
{ text = text $0 "\n" }
function skip() { sub(/^[ \t\r\n]+/, "", text) }
function take(pattern) { skip(); if (!match(text, "^(" pattern ")")) return 0; text = substr(text, RLENGTH + 1); return 1 }
function string() { return take("\"[^\"\\\\]*\"") }
function value() {
    if (take("\\{")) {
        if (take("\\}")) return 1
        do { if (!string() || !take(":") || !value()) return 0 } while (take(","))
        return take("\\}")
    }
    if (take("\\[")) {
        if (take("\\]")) return 1
        do { if (!value()) return 0 } while (take(","))
        return take("\\]")
    }
    return string() || take("-?(0|[1-9][0-9]*)(\\.[0-9]+)?([eE][-+]?[0-9]+)?") || take("true|false|null")
}
END { good = value(); skip(); exit !(good && text == "") }
END
well_formed() { awk -f json.awk "$1"; }
printf '{"a": [1, -2.5e+3, {}], "b": null}\n' >good.json
check 'the JSON reader accepts' well_formed good.json
for text in '{"a": nan}' '{"a": 1,}' '{"a": [1 2]}' '{"a": 1' '{"a": inf}' '{"a": 1} 2' '{"a": 01}'; do
    printf '%s\n' "$text" >bad.json
    check "the JSON reader refuses $text" not well_formed bad.json
done

keys='seconds_load seconds_build seconds_start seconds_direct seconds_chain triangles mutations mutations_per_second rays rays_per_mutation
      b b_stderr estimated_relative_error peak_bytes bad_samples longest_rejection_run
      tiles tiles_disagreeing largest_tile_error effective_sample_size chain_part light_missed'
for options in 'room.obj' 'room.obj --integrator path' 'room.obj --integrator bdpt' 'room.obj --direct only' 'dark.obj' 'blind.obj' 'room.obj -s 1x1 -n 0.5' \
               'room.obj -t 0.0001'; do
    expect 0 $short $options --stats out/stats -o out/a.pfm
    check "well-formed: $options" well_formed out/stats
    for key in $keys; do check "key $key: $options" grep -q "^ *\"$key\": [-0-9n]" out/stats; done
    check "key strategies: $options" grep -q '"strategies": \[' out/stats
    check "key classes: $options" grep -q '"classes": \[' out/stats
done
expect 0 room.obj $short --direct chain --stats out/stats -o out/a.pfm     # all light to the chains: none of the rounds is black
check 'mutations are -n times pixels' test "$(value mutations out/stats)" -eq $((4 * 24 * 16))
check 'triangles' test "$(value triangles out/stats)" -eq 6
check 'bad_samples' test "$(value bad_samples out/stats)" -eq 0
check 'memory' between 1e5 1e10 "$(value peak_bytes out/stats)"
check 'b' between 1e-3 1e3 "$(value b out/stats)"
for name in bidir lens caustic chain subpath manifold; do check "strategy $name" grep -q "\"name\": \"$name\", \"proposed\": [0-9]*, \"zero\": [0-9]*, \"accepted\": [0-9]*" out/stats; done
check 'proposals add up' awk -v all="$(value mutations out/stats)" '
    /"proposed"/ {
        gsub(/[^0-9,:]/, ""); split($0, part, /[,:]+/)
        proposed = part[2]; zero = part[3]; accepted = part[4]; reasons = 0
        for (i = 5; i in part; i++) reasons += part[i]
        if (zero + accepted > proposed || reasons != zero) bad = 1
        sum += proposed
    }
    END { exit bad || sum == 0 || sum > all }' out/stats
expect 0 room.obj $short --stats - -o out/a.pfm
check '--stats - is JSON on standard output' well_formed stdout
expect 0 room.obj $short --stats /dev/null -o out/a.pfm
check 'a device is not replaced by a file' test -c /dev/null
sweep

# ---- what the picture says of itself ----

# Estimated over true relMSE, its median over seeds; the reference has a hundred times the work. Four times the work has half the error.
expect 0 "$shipped/cornell.obj" -q -s 24x24 -n 5000 --seed 100 -o out/reference.pfm
for seed in 1 2 3 4 5 6 7 8 9; do
    errors=
    for work in 50 200; do
        expect 0 "$shipped/cornell.obj" -s 24x24 -n $work --seed $seed --stats out/stats -o out/a.pfm
        check "nothing found by chance in cornell: seed $seed, -n $work" silent
        check "all tiles agree: seed $seed, -n $work" test "$(value tiles_disagreeing out/stats)" -eq 0
        expect 0 compare out/a.pfm out/reference.pfm
        errors="$errors $(value estimated_relative_error out/stats) $(said relmse)"
    done
    echo $errors >>errors
done
# ratio ESTIMATED TRUE: median of these columns of the file
ratio() { awk -v e="$1" -v t="$2" '{ print $e * $e / $t }' errors | sort -g | sed -n 5p; }
check "the estimated error is the true one: median ratio $(ratio 1 2)" between 0.5 2 "$(ratio 1 2)"
check "an error estimated half as large is noticed: median ratio $(ratio 3 2)" between 0.01 0.5 "$(ratio 3 2)"
check "an error estimated twice as large is noticed: median ratio $(ratio 1 4)" between 2 100 "$(ratio 1 4)"

# Of 160 samples few come through the gap of the door, and rounds differ by what they have found.
for seed in $(seq 9); do
    expect 0 "$shipped/door.obj" -s 80x60 -n 50 --bootstrap 160 --seed $seed --stats out/stats -o out/a.pfm
    grep -q '^mlt: warning: .* tiles got most' stderr && break
done
check 'a warning for light found by chance' grep -q '^mlt: warning: .* tiles got most of their light in one round' stderr
check 'counted' between 1 15 "$(value tiles_disagreeing out/stats)"
check 'a warning for the class of paths' grep -q '^mlt: warning: diffuse reflection: .* samples' stderr
# The floor of the pool rests on paths that only walks through the water find: bent ones find them at once.
expect 0 "$shipped/pool.obj" -s 80x60 -n 50 --stats out/stats -o out/a.pfm
check 'none for the floor of the pool' not grep -q '^mlt: warning: caustics seen' stderr

# Of 16 samples few come through the gap of the door, but the path tracer's do in most runs, and leave the light to the chains.
for seed in $(seq 40); do
    expect 0 "$shipped/door.obj" -s 48x36 -n 50 --bootstrap 16 --seed $seed --stats out/stats -o out/a.pfm
    grep -q '^mlt: warning: some [0-9]* % of the light are missing' stderr && break
done
check 'a warning for light that the chains have not found' grep -q '^mlt: warning: some [0-9]* % of the light are missing' stderr
check 'how much' between 0.02 10 "$(value light_missed out/stats)"
expect 0 "$shipped/pool.obj" -s 640x480 -t 0.03 --stats out/stats -o out/a.pfm
check 'a warning where no chain has run' grep -q '^mlt: warning: .* too short for the chains' stderr
expect 0 "$shipped/cornell.obj" -s 900x900 -t 0.5 -o out/a.pfm
check 'for a large film, too' grep -q '^mlt: warning: .* too short for the chains' stderr
expect 0 "$shipped/cornell.obj" -q --integrator path -s 900x900 -n 2 -o out/b.pfm
expect 0 compare out/a.pfm out/b.pfm
check "without chains all of the light is there: $(said ratio_of_means)" between 0.98 1.02 "$(said ratio_of_means)"
expect 0 "$shipped/pool.obj" -q -s 80x60 -n 50 -o out/a.pfm
check 'no warning with -q' silent
sweep

# ---- quiet and verbose ----

expect 0 room.obj -n 4 --bootstrap 500 -o out/a.pfm
check 'no progress line where there is no terminal' silent
expect 0 room.obj -v -n 4 --bootstrap 500 -o out/a.pfm
check 'the summary is on standard error' test ! -s stdout
check 'the table of strategies stands below its heading' test "$(sed -n '/^strategy/{n;s/ .*//p;}' stderr)" = bidir
for word in triangles seconds mutations bidir 'estimated error'; do check "the summary has '$word'" grep -q "$word" stderr; done
expect 1 -q broken.obj -o out/a.pfm
check '-q does not hide errors' test -s stderr
expect 0 room.obj -n 1 --bootstrap 500 --strategies lens -o out/a.pfm
check 'a warning for strategies that are not ergodic' grep -q '^mlt: warning: .*ergodic' stderr
expect 0 room.obj -n 1 --bootstrap 500 --strategies caustic -o out/a.pfm
check 'a warning for strategies of no use' grep -q '^mlt: warning: ' stderr
expect 0 room.obj -n 1 --bootstrap 500 --strategies subpath,bidir -o out/a.pfm
check 'no warning with bidir' silent
sweep

# ---- black scenes: a warning and a black picture ----

for scene in dark blind; do
    for options in '--integrator mlt' '--integrator path' '--integrator bdpt' '--direct chain' '--direct only' '--direct none' '-e 0.1 -t 3'; do
        expect 0 $scene.obj -n 2 --bootstrap 500 $options -o out/a.pfm
        check "a warning: $scene, $options" grep -q '^mlt: warning: .*black' stderr
        check "black: $scene, $options" all_zero out/a.pfm $((12 * 24 * 16))
    done
    expect 0 $scene.obj $short -o out/a.pfm
    check "no warning with -q: $scene" silent
done
# No error can be estimated where there is nothing to see, and where all light is direct chains find nothing: -e alone must end all the same.
for options in 'blind.obj -s 4x4' 'blind.obj -s 4x4 --integrator path' 'blind.obj -s 4x4 --integrator bdpt' 'room.obj -s 64x64 --max-depth 2'; do
    "$mlt" -q -e 0.01 $options -o out/a.pfm &
    render=$!
    (for second in 1 2 3 4 5 6 7 8 9 10; do sleep 1; done; kill -KILL $render) >/dev/null 2>&1 &
    watchdog=$!
    wait $render
    check "-e ends the run: $options" test $? -eq 0
    kill $watchdog 2>/dev/null
done
sweep

# ---- compare ----

printf 'PF\n1 1\n-1\n\000\000\000\100\000\000\000\100\000\000\000\100' >two.pfm
printf 'PF\n1 1\n-1\n\000\000\200\077\000\000\200\077\000\000\200\077' >one.pfm
printf 'PF\n1 1\n-1\n\000\000\200\077' >half.pfm
expect 0 compare two.pfm one.pfm
check 'rmse of 2 against 1' between 0.999999 1.000001 "$(said rmse)"
check 'relmse of 2 against 1: 1/1.01' between 0.990098 0.9901 "$(said relmse)"
check 'ratio of means of 2 against 1' between 1.999999 2.000001 "$(said ratio_of_means)"
check 'three lines, no message' test "$(wc -l <stdout)" -eq 3 -a ! -s stderr
expect 0 compare first.pfm first.pfm
check 'a picture against itself' test "$(tr '\n' ' ' <stdout)" = 'rmse 0 relmse 0 ratio_of_means 1 '
expect 0 compare -- first.pfm first.pfm
for pair in 'one.pfm first.pfm' 'nowhere.pfm one.pfm' 'one.pfm nowhere.pfm' 'half.pfm one.pfm' 'room.obj one.pfm'; do
    expect 1 compare $pair
    check "message, and no result: compare $pair" test -s stderr -a ! -s stdout
done
expect 0 compare --help

check 'no temporary files left' test -z "$left$(find . -name '*.tmp*')"
report
