"use strict";
(() => {
  const LIGHT = {
    ink: "#1c1f23", muted: "#5a626b", grid: "#e3e6ea", zero: "#b5bcc4", band: "rgba(90,98,107,0.13)", paper: "#ffffff",
    blue: "#0072b2", vermilion: "#d55e00", green: "#009e73", black: "#000000", purple: "#b85f93", orange: "#cc8400",
    grey: "#737373", soft: "#c9ced4",
  };
  const DARK = {
    ink: "#e6e8eb", muted: "#a3abb5", grid: "#2c3138", zero: "#555d67", band: "rgba(163,171,181,0.18)", paper: "#15181c",
    blue: "#56b4e9", vermilion: "#ff8a4c", green: "#2fcfa0", black: "#f2f2f2", purple: "#e59ac8", orange: "#f0b429",
    grey: "#9a9a9a", soft: "#4a525c",
  };
  const PRINTED_WIDTH = 660; // px: A4 and Letter hold it
  const PRINTED_GAP = 20;
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const coarse = matchMedia("(pointer: coarse)").matches; // fingers scroll the page, they do not zoom charts
  const toolbars = !coarse && matchMedia("(hover: hover)").matches; // else they would stay over the charts
  let printing = false;
  const palette = () => (dark.matches && !printing ? DARK : LIGHT);

  // ---- Charts -------------------------------------------------------------------------------------------------------

  /** Copies plain data with colour roles turned into colours; numbers are shared, not copied. */
  function painted(value, colours, key = "") {
    if (Array.isArray(value)) return value.map((item) => painted(item, colours, key));
    if (value !== null && typeof value === "object") {
      if ("bdata" in value) return value;
      return Object.fromEntries(Object.entries(value).map(([name, item]) => [name, painted(item, colours, name)]));
    }
    const role = typeof value === "string" && /color$/.test(key) && value.startsWith("@") ? value.slice(1) : "";
    return role in colours ? colours[role] : value;
  }

  function layoutOf(spec, colours, width, height, extra) {
    const layout = painted(spec.layout, colours);
    for (const name of Object.keys(layout).filter((key) => /^[xy]axis\d*$/.test(key))) {
      layout[name] = {
        gridcolor: colours.grid, zerolinecolor: colours.zero, linecolor: colours.zero, automargin: true, nticks: 7,
        exponentformat: "power", tickangle: 0, ...layout[name],
      };
      // As many names as have room beside one another, in the part of the width that the axis takes.
      const [from, to] = layout[name].domain || [0, 1];
      const room = name[0] === "x" ? (Math.min(width, layout.maxWidth || width) - 80) * (to - from) : height;
      layout[name].nticks = Math.max(3, Math.min(layout[name].nticks, Math.floor(room / (name[0] === "x" ? 36 : 30))));
      const title = layout[name].title;
      if (title) layout[name].title = { standoff: 8, ...title, font: { size: 12 } };
    }
    const widest = layout.maxWidth;
    delete layout.maxWidth;
    const tallest = layout.aspect ? Math.min(width, widest || width) * layout.aspect + 60 + extra : height;
    delete layout.aspect;
    return {
      width: Math.min(width, widest || width), height: Math.min(height, tallest), autosize: false, paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
      font: { family: "system-ui, -apple-system, 'Segoe UI', Roboto, 'Noto Sans', sans-serif", size: 12, color: colours.ink },
      margin: { l: 56, r: 10, t: 10, b: 42 }, hovermode: "closest", uirevision: "keep", dragmode: coarse ? false : "zoom",
      legend: { orientation: "h", x: 0, y: 1.02, yanchor: "bottom", font: { size: 11 } },
      hoverlabel: { bgcolor: colours.paper, bordercolor: colours.muted, font: { color: colours.ink } },
      ...layout,
    };
  }

  // Buttons are named one by one: plotly.js has one that sends a chart to a server.
  const config = (...buttons) => ({
    displaylogo: false, responsive: false, scrollZoom: false, displayModeBar: toolbars ? "hover" : false, showSendToCloud: false,
    plotlyServerURL: "", modeBarButtons: [buttons],
  });
  const CONFIG = config("toImage", "zoom2d", "pan2d", "resetScale2d");
  const charts = [...document.querySelectorAll(".chart")].map((box) => ({
    box, spec: JSON.parse(box.nextElementSibling.textContent), height: parseInt(box.style.height, 10), drawn: false, width: 0,
  }));

  function draw(chart) {
    const half = chart.box.parentElement.classList.contains("half");
    const printed = half ? (PRINTED_WIDTH - PRINTED_GAP) / 2 : PRINTED_WIDTH;
    const width = printing ? printed : Math.max(220, Math.floor(chart.box.clientWidth));
    const colours = palette();
    chart.drawn = true;
    chart.width = width;
    const data = painted(chart.spec.data, colours);
    // Names of lines take separate rows where a chart is narrow.
    const names = data.filter((trace) => trace.showlegend !== false && trace.name).map((trace) => trace.name.length);
    const across = Math.max(1, Math.floor((width - 70) / (6.2 * Math.max(0, ...names) + 45)));
    const height = chart.height + 19 * Math.max(0, Math.ceil(names.length / across) - 1);
    const layout = layoutOf(chart.spec, colours, width, height, height - chart.height);
    chart.box.style.height = `${layout.height}px`;
    const { x, y, z } = data[0] || {}; // a map's contours are drawn from its own cells
    const traces = data.map((trace) => (trace.type === "contour" ? { ...trace, x, y, z } : trace));
    return Plotly.react(chart.box, traces, layout, CONFIG);
  }

  // What is looked at first is drawn first; the rest when it comes near.
  const watcher = new IntersectionObserver(
    (entries) => {
      for (const entry of entries) {
        const chart = charts.find((one) => one.box === entry.target);
        if (entry.isIntersecting && !chart.drawn) draw(chart);
      }
    },
    { rootMargin: "1200px 0px" },
  );
  charts.forEach((chart) => watcher.observe(chart.box));

  // Older browsers do not open a closed page that a link leads into.
  function openLinked() {
    const linked = document.getElementById(decodeURIComponent(location.hash.slice(1)));
    const page = linked && linked.closest("details");
    if (page && !page.open) {
      page.open = true;
      linked.scrollIntoView();
    }
  }
  addEventListener("hashchange", openLinked);
  openLinked();

  // ---- The machine in space -----------------------------------------------------------------------------------------

  /** Have the view move and follow its slider; a page without a run has none. */
  function space(view) {
    const scene = JSON.parse(document.getElementById("scene").textContent);
    const gl = document.getElementById("webgl");
    const slider = document.getElementById("instant");
    const button = document.getElementById("play");
    const readout = document.getElementById("readout");
    const numbers = (spec) => {
      const bytes = Uint8Array.from(atob(spec.bdata), (letter) => letter.charCodeAt(0));
      return new Float32Array(bytes.buffer);
    };
    const runs = {};
    for (const name of ["time", "position", "rotation", "joints", "image", "displacement", "turn", "error", "used", "limit"]) {
      runs[name] = numbers(scene[name]);
    }
    if (scene.feet) runs.feet = numbers(scene.feet);
    if (scene.targets) runs.targets = numbers(scene.targets);
    const COLOURS = ["blue", "vermilion", "green", "black", "purple", "orange"];
    const POINTS = scene.goals.map((_, point) => COLOURS[point % COLOURS.length]);
    const GAP = [null, null, null];
    const HALF_ANGLE = Math.PI / 8; // half the angle of view of plotly.js, up and down
    const NAMES = [55, 32]; // px beside the box, and above and below it, for numbers and names of the axes

    /** Puts a point of C into B at an instant. */
    function placed(frame, point) {
      const p = [0, 1, 2].map((row) => scene.camera[row] + scene.axes[row].reduce((sum, axis, at) => sum + axis * point[at], 0));
      return scene.onBase ? p : carried(frame, p);
    }
    /** Puts a point of E into B at an instant. */
    function carried(frame, p) {
      const R = runs.rotation.subarray(9 * frame, 9 * frame + 9);
      const o = runs.position.subarray(3 * frame, 3 * frame + 3);
      return [0, 1, 2].map((row) => o[row] + R[3 * row] * p[0] + R[3 * row + 1] * p[1] + R[3 * row + 2] * p[2]);
    }
    /** Where the target is in B at an instant. */
    function targets(frame) {
      const size = 3 * POINTS.length;
      const at = Math.min(frame * size, runs.targets.length - size); // at rest they are there once
      return POINTS.map((_, point) => {
        const place = [...runs.targets.subarray(at + 3 * point, at + 3 * point + 3)];
        return isNaN(place[0]) ? GAP : scene.onBase ? carried(frame, place) : place;
      });
    }
    const coordinates = (points) => ({
      x: points.map((p) => p[0]), y: points.map((p) => p[1]), z: points.map((p) => p[2]),
    });
    const imagePoint = (frame, point) => {
      const at = 3 * (POINTS.length * frame + point);
      return runs.image.subarray(at, at + 3);
    };

    /** Where a rod begins: at the end of its crank, or a leg without one at the base. */
    const rodFoot = (frame, leg) =>
      (runs.feet ? [...runs.feet.subarray(18 * frame + 3 * leg, 18 * frame + 3 * leg + 3)] : scene.base[leg]);
    const isBeyond = (frame, leg) => runs.used[6 * frame + leg] > 1;

    /** What moves: the coordinates of each trace at an instant. */
    function moving(frame) {
      const camera = placed(frame, [0, 0, 0]);
      const joints = [0, 1, 2, 3, 4, 5].map((leg) => [...runs.joints.subarray(18 * frame + 3 * leg, 18 * frame + 3 * leg + 3)]);
      const [corners, border] = [scene.corners, scene.border].map((points) => points.map((point) => placed(frame, point)));
      const legs = (wanted) => [0, 1, 2, 3, 4, 5].filter((leg) => wanted === isBeyond(frame, leg));
      const rods = (wanted) => [GAP, ...legs(wanted).flatMap((leg) => [rodFoot(frame, leg), joints[leg], GAP])];
      const cranks = (wanted) => [GAP, ...(runs.feet ? legs(wanted) : []).flatMap((leg) => [scene.base[leg], rodFoot(frame, leg), GAP])];
      const traces = [
        rods(false), rods(true), cranks(false), cranks(true),
        [scene.onBase ? carried(frame, [0, 0, 0]) : camera, ...joints],
        [...joints, joints[0]],
        [...corners.flatMap((corner) => [camera, corner, GAP]), ...border, border[0]],
        scene.goals.map((goal) => placed(frame, goal)),
        POINTS.map((_, point) => (isNaN(imagePoint(frame, point)[0]) ? GAP : placed(frame, imagePoint(frame, point)))),
      ];
      for (let point = 0; point < POINTS.length; point += 1) {
        const path = [];
        for (let past = 0; past <= frame; past += 1) {
          const place = imagePoint(past, point);
          path.push(isNaN(place[0]) ? GAP : placed(frame, place));
        }
        traces.push(path);
        if (scene.targets) traces.push([camera, targets(frame)[point]]);
      }
      if (scene.targets) traces.push(targets(frame));
      return traces.map(coordinates);
    }

    function traces(colours, frame) {
      const each = POINTS.map((name) => colours[name]);
      const line = (color, width, more = {}) => ({ type: "scatter3d", mode: "lines", line: { color, width, ...more }, hoverinfo: "skip" });
      const dots = (color, size, symbol, name) => ({
        type: "scatter3d", mode: "markers", marker: { color, size, symbol, line: { width: 0 } }, name,
        text: POINTS.map((_, point) => `${name} ${point + 1}`), hoverinfo: "text",
      });
      const moved = [
        line(colours.muted, runs.feet ? 5 : 9), line(colours.vermilion, runs.feet ? 6 : 10),
        line(colours.ink, 11), line(colours.vermilion, 12),
        {
          type: "mesh3d", color: colours.blue, opacity: 0.75, hoverinfo: "skip", flatshading: true, lighting: { ambient: 0.9, diffuse: 0.3 },
          i: [0, 0, 0, 0, 0, 0], j: [1, 2, 3, 4, 5, 6], k: [2, 3, 4, 5, 6, 1],
        },
        line(colours.blue, 4),
        line(colours.muted, 2),
        dots(each, 5, "square-open", "goal"),
        dots(each, 4, "circle", "feature"),
      ];
      for (let point = 0; point < POINTS.length; point += 1) {
        moved.push(line(each[point], 5));
        if (scene.targets) moved.push(line(each[point], 1.5));
      }
      if (scene.targets) moved.push(dots(each, 6, "circle", "target"));
      const places = moving(frame);
      const still = [{ ...line(colours.muted, 3), ...coordinates([...scene.base, scene.base[0]]) }];
      still.push({
        type: "mesh3d", color: colours.soft, opacity: 0.6, hoverinfo: "skip", ...coordinates(scene.base),
        i: [0, 0, 0, 0], j: [1, 2, 3, 4], k: [2, 3, 4, 5],
      });
      return [...moved.map((trace, number) => ({ ...trace, ...places[number] })), ...still].map((trace) => ({ ...trace, showlegend: false }));
    }

    function sceneLayout(colours) {
      const axis = (name, at, reversed) => ({
        title: { text: `${name} [m]`, font: { size: 11 } }, color: colours.muted, gridcolor: colours.grid, zerolinecolor: colours.grid,
        showbackground: false, showspikes: false, nticks: 5, tickfont: { size: 10 },
        range: reversed ? [scene.high[at], scene.low[at]] : [scene.low[at], scene.high[at]],
      });
      return {
        width: gl.clientWidth, height: gl.clientHeight, autosize: false, margin: { l: 0, r: 0, t: 0, b: 0 }, paper_bgcolor: "rgba(0,0,0,0)", uirevision: "keep",
        font: { family: "system-ui, sans-serif", color: colours.ink },
        hoverlabel: { bgcolor: colours.paper, bordercolor: colours.muted, font: { color: colours.ink } },
        scene: {
          aspectmode: "manual", dragmode: "turntable", uirevision: "keep",
          aspectratio: ratio(),
          xaxis: axis("x", 0, false), yaxis: axis("y", 1, scene.zDown), zaxis: axis("z", 2, scene.zDown),
          camera: { eye: viewpoint(), up: { x: 0, y: 0, z: 1 }, projection: { type: "perspective" } },
        },
      };
    }
    /** The nearest place in the direction of the view from which the box and the names of its axes are within the picture. */
    function viewpoint() {
      const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
      const away = Math.hypot(...scene.view);
      const toward = scene.view.map((part) => part / away);
      const level = Math.hypot(toward[0], toward[1]);
      const right = [-toward[1] / level, toward[0] / level, 0];
      const up = [-toward[2] * right[1], toward[2] * right[0], level];
      const [width, height] = [gl.clientWidth, gl.clientHeight];
      const [across, along] = [width - 2 * NAMES[0], height - 2 * NAMES[1]].map((size) => Math.tan(HALF_ANGLE) * Math.max(size, 100) / height);
      const half = Object.values(ratio()).map((size) => size / 2);
      const places = [0, 1, 2, 3, 4, 5, 6, 7].map((corner) => {
        const at = half.map((size, axis) => (corner >> axis & 1 ? size : -size));
        return dot(at, toward) + Math.max(Math.abs(dot(at, right)) / across, Math.abs(dot(at, up)) / along);
      });
      const [x, y, z] = toward.map((part) => part * Math.max(...places));
      return { x, y, z };
    }
    function ratio() {
      const size = [0, 1, 2].map((at) => scene.high[at] - scene.low[at]);
      const scale = Math.min(1.25 / Math.cbrt(size[0] * size[1] * size[2]), 2 / Math.max(...size));
      return { x: size[0] * scale, y: size[1] * scale, z: size[2] * scale };
    }

    // The camera's image: positions on the image plane, y up.
    const SVG = "http://www.w3.org/2000/svg";
    const picture = document.getElementById("image");
    const [left, low, right, high] = [Math.min, Math.max].flatMap((most) => [0, 1].map((at) => most(...scene.border.map((place) => place[at]))));
    const scale = 200 / (right - left);
    function shape(tag, className, attributes) {
      const made = document.createElementNS(SVG, tag);
      made.setAttribute("class", className);
      for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
      picture.append(made);
      return made;
    }
    picture.setAttribute("viewBox", `${scale * left} ${-scale * high} 200 ${scale * (high - low)}`);
    const onPicture = (place) => [scale * place[0], -scale * place[1]];
    function walk(point, frames) {
      let text = "", shown = false; // at the instant before
      for (let frame = 0; frame < frames; frame += 1) {
        const place = onPicture(imagePoint(frame, point));
        if (!isNaN(place[0])) text += `${shown ? "L" : "M"}${place[0].toFixed(2)} ${place[1].toFixed(2)}`;
        shown = !isNaN(place[0]);
      }
      return text;
    }
    shape("path", "axis", { d: `M${scale * left} 0H${scale * right}M0 ${-scale * high}V${-scale * low}` });
    shape("path", "axis", { d: `M${scene.border.map((place) => onPicture(place).join(" ")).join("L")}Z` });
    const seen = POINTS.map((name, point) => {
      const [x, y] = onPicture(scene.goals[point]);
      shape("rect", name, { x: x - 4, y: y - 4, width: 8, height: 8 });
      shape("path", `past ${name}`, { d: walk(point, runs.time.length) });
      return { path: shape("path", name, {}), dot: shape("circle", `dot ${name}`, { r: 2.4 }) };
    });
    function showImage(frame) {
      seen.forEach(({ path, dot }, point) => {
        const [x, y] = onPicture(imagePoint(frame, point));
        path.setAttribute("d", walk(point, frame + 1));
        dot.style.display = isNaN(x) ? "none" : "";
        if (!isNaN(x)) { dot.setAttribute("cx", x); dot.setAttribute("cy", y); }
      });
    }

    /** The leg that uses most of one of its limits. */
    function nearestLimit(frame) {
      const used = runs.used.subarray(6 * frame, 6 * frame + 6);
      const leg = used.indexOf(Math.max(...used));
      return `leg ${leg + 1} uses ${(100 * used[leg]).toFixed(0)} % of its ${scene.limits[runs.limit[6 * frame + leg]]}`;
    }

    function tell(frame) {
      showImage(frame);
      const vector = (values) => [...values.subarray(3 * frame, 3 * frame + 3)].map((value) => (Math.round(value * 100) / 100 || 0).toFixed(2)).join(", ");
      const error = runs.error[frame];
      const shown = error > 0 && error < 1e-6 ? "<1e-6" : Number(error.toPrecision(4)); // as metrics.shown_number
      const text = `t = ${runs.time[frame].toFixed(3)} s; largest feature error ${shown} px; ` +
        `moved (${vector(runs.displacement)}) mm; turned (${vector(runs.turn)}) mrad; ${nearestLimit(frame)}`;
      readout.textContent = text;
      slider.setAttribute("aria-valuetext", `t = ${runs.time[frame].toFixed(3)} s`);
    }

    function show(frame) {
      const places = moving(frame);
      tell(frame);
      return Plotly.restyle(
        gl, { x: places.map((at) => at.x), y: places.map((at) => at.y), z: places.map((at) => at.z) }, places.map((_, number) => number),
      );
    }

    function hasWebGL() {
      try {
        const canvas = document.createElement("canvas");
        return Boolean(canvas.getContext("webgl") || canvas.getContext("experimental-webgl"));
      } catch (error) {
        return false;
      }
    }
    function standIn(reason) {
      view.classList.remove("moving");
      const words = document.getElementById("webgl-missing");
      words.textContent = `${reason}: this is a still picture of the end of the run.`;
      words.hidden = false;
      stop();
    }

    let timer = 0;
    function stop() {
      clearTimeout(timer);
      timer = 0;
      button.textContent = "Play";
    }
    function step() {
      const frame = Number(slider.value);
      if (frame >= Number(slider.max)) return stop();
      slider.value = String(frame + 1);
      return show(frame + 1).then(() => {
        if (timer) timer = setTimeout(step, 30);
      });
    }
    button.addEventListener("click", () => {
      if (timer) return stop();
      if (Number(slider.value) >= Number(slider.max)) slider.value = "0";
      button.textContent = "Stop";
      timer = setTimeout(step, 0);
      return undefined;
    });
    let wanted = false;
    slider.addEventListener("input", () => {
      stop();
      if (wanted) return;
      wanted = true; // many events, one picture each time the browser paints
      requestAnimationFrame(() => {
        wanted = false;
        show(Number(slider.value));
      });
    });

    function drawSpace() {
      const colours = palette();
      return Plotly.react(gl, traces(colours, Number(slider.value)), sceneLayout(colours), config("toImage", "pan3d", "tableRotation", "resetCameraDefault3d"));
    }
    let movable = false;
    if (hasWebGL()) {
      view.classList.add("moving");
      slider.value = slider.max;
      const begin = new IntersectionObserver((entries) => {
        if (!entries.some((entry) => entry.isIntersecting)) return;
        begin.disconnect();
        tell(Number(slider.value));
        drawSpace().then(() => {
          movable = true;
          gl.dataset.ready = "yes";
          gl.on("plotly_webglcontextlost", () => standIn("The browser gave up WebGL"));
        }).catch(() => standIn("The view in space could not be drawn"));
      }, { rootMargin: "600px 0px" });
      begin.observe(gl);
    } else {
      standIn("This browser has no WebGL");
    }

    return {
      redraw: () => { if (movable && !printing) drawSpace(); },
      resize: () => { if (movable) Plotly.relayout(gl, { width: gl.clientWidth, height: gl.clientHeight }); },
    };
  }
  const view = document.getElementById("view");
  const machine = view && space(view);

  // ---- Scheme, width, print -----------------------------------------------------------------------------------------

  function redraw() {
    charts.filter((chart) => chart.drawn).forEach(draw);
    if (machine) machine.redraw();
  }
  dark.addEventListener("change", redraw);
  let resizing = 0;
  addEventListener("resize", () => {
    clearTimeout(resizing);
    resizing = setTimeout(() => {
      if (printing) return;
      charts.filter((chart) => chart.drawn && Math.floor(chart.box.clientWidth) !== chart.width).forEach(draw);
      if (machine) machine.resize();
    }, 120);
  });
  /** Redraws all charts: the drawing that plotly.js keeps does not fit a page's width. */
  function turn(paper) {
    printing = paper;
    for (const chart of charts) {
      Plotly.purge(chart.box);
      draw(chart);
    }
  }
  addEventListener("beforeprint", () => turn(true));
  addEventListener("afterprint", () => turn(false));
})();
