// Time of the playback: who changes it, and who wants to know.

class Clock {
  constructor(begin, end) {
    this.begin = begin;
    this.end = end;
    this.now = Math.min(Math.max(0, begin), end);
    this.speed = 1;
    this.playing = false;
    this.listeners = [];
    this.last = 0;
  }

  listen(call) {
    this.listeners.push(call);
    call(this);
  }

  tell() {
    for (const call of this.listeners) call(this);
  }

  seek(time) {
    this.now = Math.min(Math.max(time, this.begin), this.end);
    this.tell();
  }

  toggle() {
    if (!this.playing && this.now >= this.end) this.now = Math.max(this.begin, 0);
    this.playing = !this.playing;
    this.last = 0;
    if (this.playing) requestAnimationFrame((time) => this.step(time));
    this.tell();
  }

  step(time) {
    if (!this.playing) return;
    const passed = this.last ? Math.min((time - this.last) / 1000, 0.25) : 0;
    this.last = time;
    this.now = Math.min(this.now + passed * this.speed, this.end);
    if (this.now >= this.end) this.playing = false;
    else requestAnimationFrame((next) => this.step(next));
    this.tell();
  }
}
