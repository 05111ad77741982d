# What happens inside the virtual machine. Clips of raw frames are played into the output node of vivid, come out of its
# capture node, and the monitor says on vcan0 what it makes of them. vcan1 carries the marks: what is done to camera and
# bus, and when. What is to be judged goes to /share.
ip=/usr/bin/ip
tc=/usr/bin/tc
capture="v4l2-ctl -d /dev/video0"
output="v4l2-ctl -d /dev/video1"
# 1280x720 at 30 frames a second; frames of another size are scaled on their way in and back on their way out.
timings=index=5

# The program with the libraries of the host.
cat >/bin/gapwatch <<'END'
#!/bin/sh
exec /tmp/lib/ld-linux-x86-64.so.2 --library-path /tmp/lib /tmp/gapwatch "$@"
END
chmod +x /bin/gapwatch

# mark WORD: at most 8 characters, in a frame of their own. The console shows how far it is.
mark() {
  echo "$1" >/dev/ttyS0
  cansend vcan1 7F0#"$(printf %s "$1" | od -An -tx1 | tr -d ' \n')"
}

# With CAN FD, and a queue of the length that is asked for.
bus_up() {
  $ip link add "$1" type vcan
  $ip link set "$1" mtu 72
  $ip link set "$1" txqueuelen "$queue"
  $tc qdisc add dev "$1" root pfifo limit "$queue"
  $ip link set "$1" up
}

camera_on() {
  $capture --set-dv-bt-timings $timings >/dev/null
  $output --set-dv-bt-timings $timings >/dev/null
  $capture -c osd_text_mode=2 -c loop_video=1
  $output --set-fmt-video-out=width=320,height=160,pixelformat=YUYV
}

play() { $output --stream-out-mmap=4 --stream-from=- >/dev/null 2>&1; }

# Plays the clip that `show` names, again and again, and marks every change.
player() {
  shown=nominal
  while [ ! -e quiet ]; do
    clip=$(cat showing)
    [ "$clip" = "$shown" ] || mark "$clip"
    shown=$clip
    cat clips/"$clip" || break
  done 2>/dev/null | play
}

# In one step, since the player reads it at any moment.
show() {
  echo "$1" >showing.new
  mv showing.new showing
}

# picture CLIP SECONDS: shows it for a while.
picture() {
  show "$1"
  sleep "$2"
  show nominal
  sleep 1.5
}

# during NAME COMMAND: runs a command that makes a fault; `over COMMAND` ends it.
during() {
  mark "$1"
  shift
  "$@"
  sleep 1.5
}
over() {
  mark nominal
  "$@"
  sleep 1.5
}

control() { $capture -c "$1"; }

# Either of vivid's two nodes may take the flag.
damage() {
  for _ in 1 2 3 4 5 6 7 8; do
    control inject_v4l2_buf_flag_error=1
    sleep .05
  done
}

# These end the player too.
break_both() {
  control "$1"
  sleep .05
  player &
}

# speed HEX: the car's speed ten times a second, steps of 0.01 km/h, low byte first.
speed() {
  while :; do
    cansend vcan0 1A0#00"$1"
    sleep .1
  done
}

drive_off() {
  kill $sending
  speed 1027 &
  sending=$!
}

# The source of the picture comes back with another one, 720x480.
other_format() {
  control disconnect=1
  sleep .05
  timings=index=2
  camera_on
  player &
}
first_format() {
  control disconnect=1
  sleep .05
  timings=index=5
  camera_on
  player &
}

# random N: 0 to N-1, from the seed.
random() {
  seed=$(((seed * 1103515245 + 12345) & 0x7fffffff))
  echo $((seed / 65536 % $1))
}

# soak SEED SECONDS: a night, so that the shortest soak has one, then faults at random, each with a nominal road behind it, which
# must be long enough for any.
soak() {
  seed=$1
  kind=12
  until=$(($(date +%s) + $2))
  while [ "$(date +%s)" -lt $until ]; do
    lasting=$((1 + $(random 2))).$(random 10)
    case $kind in
      0) show black && sleep $lasting && show nominal ;;
      1) show grey && sleep $lasting && show nominal ;;
      2) show frozen && sleep $lasting && show nominal ;;
      3) show covered && sleep $lasting && show nominal ;;
      4) mark damaged && damage && sleep .3 && mark nominal ;;
      5) mark fatal && break_both inject_fatal_streaming_error=1 && sleep .3 && mark nominal ;;
      6) mark stall && control percentage_of_dropped_buffers=100 && sleep $lasting && mark nominal && control percentage_of_dropped_buffers=0 ;;
      7) mark unplug && unplug && sleep $lasting && mark nominal && plug_in ;;
      8) mark busdown && $ip link set vcan0 down && sleep $lasting && mark nominal && $ip link set vcan0 up ;;
      9) mark busgone && $ip link del vcan0 && sleep $lasting && mark nominal && bus_up vcan0 ;;
      10) mark paused && kill -STOP $monitor && sleep $lasting && mark nominal && kill -CONT $monitor ;;
      *) show night && sleep 4 && show nominal && sleep 6 ;;
    esac
    seed=$(((seed * 1103515245 + 12345) & 0x7fffffff))
    kind=$((seed / 65536 % 13))
    sleep 3.5
    grep VmRSS /proc/$monitor/status >>soak-memory.log
  done
}

unplug() { echo vivid.0 >/sys/bus/platform/drivers/vivid/unbind; }
plug_in() {
  echo vivid.0 >/sys/bus/platform/drivers/vivid/bind
  camera_on
  player &
}

cp -r /share/* .
queue=$(cat queue)
echo nominal >showing
modprobe vcan echo=1
modprobe can-raw
modprobe vivid n_devs=1 node_types=0x101 num_inputs=1 input_types=0x3 num_outputs=1 output_types=0x1
bus_up vcan0
bus_up vcan1
camera_on
candump -L any >bus.log 2>/dev/null &
logging=$!

# A drive.
cat clips/drive | play &
playing=$!
mark drive
gapwatch monitor --board car.toml --seconds 12 --journal drive.jsonl >drive.out 2>drive.err
echo $? >drive.code
mark after
wait $playing

# Faults of the picture, the camera and the bus, one after the other, each with a nominal road before and behind it. The
# driver's frame numbers wrap 4.3 s after the start.
control wrap_sequence_number=1
player &
mark faults
RUST_LOG=info gapwatch monitor --board car.toml --journal faults.jsonl >faults.out 2>faults.err &
monitor=$!
sleep 4
grep VmRSS /proc/$monitor/status >memory.log
mark wrap
sleep 1
mark nominal
sleep 1
for clip in black grey frozen covered; do picture $clip 1.8; done
picture paper 3
during damaged damage
over true
during fatal break_both inject_fatal_streaming_error=1
over true
during lost control percentage_of_dropped_buffers=30
over control percentage_of_dropped_buffers=0
during stall control percentage_of_dropped_buffers=100
over control percentage_of_dropped_buffers=0
during offline break_both disconnect=1
over true
during unplug unplug
over plug_in
during format other_format
sleep 1
over first_format
during busdown $ip link set vcan0 down
over $ip link set vcan0 up
during busfull $tc qdisc replace dev vcan0 root tbf rate 1kbit burst 32 limit $((16 * queue))
over $tc qdisc change dev vcan0 root tbf rate 1mbit burst 3200 limit $((72 * queue))
during busgone $ip link del vcan0
over bus_up vcan0
during foreign cansend vcan0 5D1#0000000000000000
over true
speed 0000 &
sending=$!
during parked sleep .5
over drive_off
kill $sending
during paused kill -STOP $monitor
over kill -CONT $monitor
show night
sleep 3
show nominal
# The longest window is 5 s, and an alarm needs 2 s to end.
sleep 9
mark clear
for frame in $(cat clear); do
  cansend vcan0 5D8#$frame
  sleep .3
done
grep VmRSS /proc/$monitor/status >>memory.log
# Nobody acknowledges: a frame in 16 s leaves the queue, and the others stay in it. Meanwhile the picture is black.
$tc qdisc replace dev vcan0 root tbf rate 8bit burst 16 limit $((16 * queue))
mark unacked
show black
sleep 4
mark acked
$tc qdisc change dev vcan0 root tbf rate 1mbit burst 3200 limit $((72 * queue))
# A queue hears of its new rate with the next frame only.
cansend vcan0 123#
sleep 1.5
mark free
show nominal
sleep 1.5
mark killed
kill -KILL $monitor
sleep .6
# The disk takes nothing more.
mkdir full
mount -t tmpfs -o size=4k full full
mark again
gapwatch monitor --board car.toml --seconds 2 --journal full/again.jsonl >again.out 2>again.err
echo $? >again.code
mark other
(while sleep .1; do cansend vcan0 5D0#0000000000000000; done) &
other=$!
gapwatch monitor --board car.toml --seconds 2 >other.out 2>other.err
echo $? >other.code
kill $other
mark end

# An adapter whose controller has trouble with its bus.
mkfifo orders
slcan orders adapter &
sleep .2
$ip link set "$(cat adapter)" name can0
$ip link set can0 type can bitrate 500000
$ip link set can0 up
sed 's/vcan0/can0/; /^fd = true$/d' car.toml >adapter.toml
mark adapter
RUST_LOG=info gapwatch monitor --board adapter.toml >adapter.out 2>adapter.err &
monitor=$!
sleep 2
mark warning
echo sw100000 >orders
sleep 1.2
mark passive
echo sp130000 >orders
sleep 1.2
mark off
echo sb000256 >orders
sleep 1
$ip link set can0 down
$ip link set can0 up
mark back
sleep 1.5
kill -TERM $monitor
wait $monitor
echo $? >adapter.code
mark done
# From here on the times of the log are those of another clock.
gapwatch monitor --board car.toml --seconds 3 >clock.out 2>clock.err &
monitor=$!
sleep 2.5
mark clock
date -s "2031-01-01 00:00:00" >/dev/null
wait $monitor
echo $? >clock.code
mark end2
# The clip's player is where the second format left it; the times of the log begin anew.
read -r soak_seed soak_seconds <soak
sed 's/^rate_hz = 10$/rate_hz = 10\nidle_rate_hz = 5/' car.toml >idle.toml
mark soak
RUST_LOG=warn gapwatch monitor --board idle.toml >soak.out 2>soak.err &
monitor=$!
sleep 4
soak "$soak_seed" "$soak_seconds"
mark soaked
kill -TERM $monitor
wait $monitor
echo $? >soak.code
sleep .2
touch quiet
kill -INT $logging
wait $logging
cp ./*.log ./*.jsonl ./*.out ./*.err ./*.code /share/
