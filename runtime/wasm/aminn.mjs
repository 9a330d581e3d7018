/**
 * AMINN in JavaScript: the C runtime as a WebAssembly module, with the names, units and frames of aminn_rt.h. For browsers and
 * Node. A module is compiled for one hand (docs/runtime.md); a model is the bytes of an aminn_model.bin.
 *
 *     const model = await Model.load(wasmBytes, modelBytes);
 *     const found = model.predict({ q, x_ht, w_e, contacts });   // flat arrays of numbers, row by row
 *     found.stable, found.p_stable, found.dx_ht;
 */

const N_WRENCH = 6;
const CONTACT = 8;
const BLOB_ALIGNMENT = 64;
const ALWAYS_STAGE2 = 1;
const DEBUG = 2;
/** Bits of `notes`. */
export const NOTE = { outOfRange: 1, illConditioned: 2, noContact: 4 };
/** What keeps a load from being larger, by `limited_by`. */
export const LIMITED_BY = ["nothing", "hold", "translation", "rotation", "slide", "range"];

/** Places of the fields (name, numbers) of a struct of floats, and how many they are in all. */
function fieldsOf(list) {
  const places = {};
  let n = 0;
  for (const [name, length] of list) {
    places[name] = [n, length];
    n += length;
  }
  return { places, n };
}

/** The structs of a hand with these counts. */
function structsOf(c) {
  const b = c.branches;
  const state = [["q", c.joints], ["x_ht", N_WRENCH], ["w_e", N_WRENCH], ["contacts", b * CONTACT]];
  const prediction = [
    ["p_stable", 1], ["dx_ht", N_WRENCH], ["k_x", N_WRENCH * N_WRENCH], ["gate", b], ["p_slide", 1], ["bound_95", 1],
    ["friction_use", b], ["condition", 1], ["stable", 1], ["notes", 1],
  ];
  const structs = {
    state,
    input: [...state, ["j_x", b * 3 * N_WRENCH], ["j_q", b * 3 * c.coordinates]],
    output: prediction,
    stage: [
      ["k_spring", b * c.coordinates ** 2], ["tendon_dir", b * c.coordinates], ["tendon_gain", b], ["gate_params", 3 * b],
      ["friction", b], ["preload", 3 * b], ["slide", b], ["dx0", N_WRENCH], ["dq0", b * c.coordinates], ["dx", N_WRENCH],
      ["k_x", N_WRENCH * N_WRENCH], ["gate", b],
    ],
    sensors: [["friction", 3], ["tool_weight", 4], ...(c.tendons ? [["tendon_tension", 1 + c.tendons]] : [])],
    limits: ["max_translation", "max_rotation", "margin", "p_stable", "p_slide", "max_scale"].map((name) => [name, 1]),
    admissible: [["scale", 1], ["admissible", 1], ["limited_by", 1], ...prediction],
  };
  return Object.fromEntries(Object.entries(structs).map(([name, list]) => [name, fieldsOf(list)]));
}

const COUNTS = ["branches", "coordinates", "joints", "gated", "twisted", "stiff", "tendons", "slides"];
const SIZES = ["context", "model", "state", "input", "output", "stage", "sensors", "limits", "admissible"];

/** An error of the runtime: its message has the code's name and meaning. */
export class AminnError extends Error {}

export class Model {
  /** Take a compiled module and a model, both as bytes. Rejects with an AminnError where the runtime refuses the model. */
  static async load(wasm, blob) {
    const { instance } = await WebAssembly.instantiate(wasm);
    return new Model(instance.exports, blob);
  }

  constructor(exports, blob) {
    this.c = exports;
    this.end = exports.__heap_base.value;
    const layout = this.words(exports.aminn_wasm_layout.value, COUNTS.length + SIZES.length);
    /** The hand's counts. */
    this.counts = Object.fromEntries(COUNTS.map((name, i) => [name, layout[i]]));
    const sizes = Object.fromEntries(SIZES.map((name, i) => [name, layout[COUNTS.length + i]]));
    this.structs = structsOf(this.counts);
    for (const [name, { n }] of Object.entries(this.structs)) {
      if (4 * n !== sizes[name]) throw new AminnError(`aminn_wasm_layout: ${name} has ${sizes[name]} bytes, not ${4 * n}`);
    }
    const at = this.take(blob.length, BLOB_ALIGNMENT);
    new Uint8Array(exports.memory.buffer, at, blob.length).set(blob);
    this.model = this.take(sizes.model);
    this.check(exports.aminn_model_from_blob(at, blob.length, this.model));
    this.context = this.take(sizes.context);
    this.at = Object.fromEntries(Object.entries(sizes).map(([name, size]) => [name, this.take(size)]));
    this.direction = this.take(4 * N_WRENCH);
    this.check(exports.aminn_init_sized(this.context, sizes.context, this.model, ALWAYS_STAGE2 | DEBUG));
    this.words(this.at.sensors, this.structs.sensors.n).fill(0);
    /** Whether the model was trained to see sensors. */
    this.senses = exports.aminn_sense(this.context, this.at.sensors) === 0;
    this.version = this.text(exports.aminn_version());
  }

  /** Name of the status code of aminn_self_test(): AMINN_OK where this machine computes the bits that it must. */
  selfTest() {
    return this.text(this.c.aminn_status_name(this.c.aminn_self_test(this.context)));
  }

  /**
   * Tell the sensors from now on: {friction: [mu, sd], tool_weight: [x, y, z], tendon_tension: [..]}; what is missing is not known.
   */
  sense(told) {
    const { places, n } = this.structs.sensors;
    const numbers = this.floats(this.at.sensors, n).fill(0);
    for (const [name, values] of Object.entries(told)) {
      if (name in places) numbers.set([1, ...values], places[name][0]);
    }
  }

  /**
   * Predict both stages of a state; with j_x and j_q of an input that has them. The result has the fields of aminn_output_t,
   * numbers or Float32Array, and `stages`, a pair with those of aminn_stage_debug_t. Throws an AminnError for a bad state.
   */
  predict(given) {
    const kind = "j_x" in given ? "input" : "state";
    this.put(kind, given);
    const predict = kind === "input" ? this.c.aminn_predict : this.c.aminn_predict_state;
    this.check(predict(this.context, this.at[kind], this.at.output));
    const found = this.get("output", this.at.output);
    found.stages = [0, 1].map((stage) => this.get("stage", this.c.aminn_debug(this.context, stage)));
    return found;
  }

  /** The largest load along a direction (6 numbers), beside the w_e of the state: fields of aminn_admissible_t. */
  admissible(state, direction, limits) {
    this.put("state", state);
    this.put("limits", limits);
    return this.admissibleAgain(direction);
  }

  /** The same of the latest state and limits. */
  admissibleAgain(direction) {
    this.floats(this.direction, N_WRENCH).set(direction);
    const { context, direction: along, at } = this;
    this.check(this.c.aminn_admissible_load(context, at.state, along, at.limits, at.admissible));
    const words = this.words(at.admissible, 3);
    return { scale: this.floats(at.admissible, 1)[0], admissible: words[1], limited_by: words[2] };
  }

  /** Name of the first number of a state that lies outside of what the model was trained on, "none" if there is none. */
  outOfRange(state) {
    this.put("state", state);
    return this.text(this.c.aminn_field_name(this.c.aminn_first_out_of_range(this.model, this.at.state)));
  }

  /** What the program aminn_replay makes of the bytes of a vector file: {result: bytes, pushes, calibration_crc, loads_crc}. */
  replay(vectors) {
    const start = this.end;
    const at = this.take(vectors.length);
    new Uint8Array(this.c.memory.buffer, at, vectors.length).set(vectors);
    const size = this.c.aminn_wasm_result_size(at);
    const result = this.take(size);
    const told = this.take(12);
    const error = this.c.aminn_wasm_replay(this.model, at, vectors.length, result, told);
    if (error) throw new AminnError(this.text(error));
    const [pushes, calibration_crc, loads_crc] = this.words(told, 3);
    const bytes = new Uint8Array(this.c.memory.buffer, result, size).slice();
    this.end = start;
    return { result: bytes, pushes, calibration_crc, loads_crc };
  }

  // --- memory ---

  /** So many bytes of the module's memory, which grows where it must. */
  take(bytes, alignment = 16) {
    const start = Math.ceil(this.end / alignment) * alignment;
    this.end = start + bytes;
    const missing = this.end - this.c.memory.buffer.byteLength;
    if (missing > 0) this.c.memory.grow(Math.ceil(missing / 65536));
    return start;
  }

  words(at, n) {
    return new Uint32Array(this.c.memory.buffer, at, n);
  }

  floats(at, n) {
    return new Float32Array(this.c.memory.buffer, at, n);
  }

  put(kind, given) {
    const { places, n } = this.structs[kind];
    const numbers = this.floats(this.at[kind], n);
    for (const [name, [start, length]] of Object.entries(places)) {
      const values = length === 1 ? [given[name]].flat() : given[name];
      if (values?.length !== length) throw new AminnError(`${name}: ${length} numbers expected`);
      numbers.set(values, start);
    }
  }

  get(kind, at) {
    const { places, n } = this.structs[kind];
    const [numbers, words] = [this.floats(at, n), this.words(at, n)];
    const found = {};
    for (const [name, [start, length]] of Object.entries(places)) {
      const whole = name === "stable" || name === "notes" ? words : numbers;
      found[name] = length === 1 ? whole[start] : numbers.slice(start, start + length);
    }
    return found;
  }

  check(status) {
    if (status) {
      throw new AminnError(`${this.text(this.c.aminn_status_name(status))}: ${this.text(this.c.aminn_status_text(status))}`);
    }
  }

  /** A C string. */
  text(at) {
    const bytes = new Uint8Array(this.c.memory.buffer, at);
    return String.fromCharCode(...bytes.subarray(0, bytes.indexOf(0)));
  }
}
