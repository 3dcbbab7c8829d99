"use strict";
// The plots of the report and the panel of the chosen design.  Texts of the study go into the page
// as text nodes, or into the plots with their markup escaped.
{
  const data = JSON.parse(document.getElementById("data").textContent);
  const element = (id) => document.getElementById(id);
  const count = data.samples.length;
  const number = { name: "", kind: "number", unit: "", goal: "", values: data.samples };
  const columns = [...data.columns, number];
  const passed = data.statuses.map((status) => status === "ok");
  const canvas = document.createElement("canvas");
  const hasWebgl = Boolean(canvas.getContext("webgl"));
  const MANY = 2000; // designs, above which SVG is slow
  const config = { responsive: true, displaylogo: false, modeBarButtonsToRemove: ["select2d", "lasso2d"] };
  let chosen = data.chosen;
  let brushed = null; // numbers of the designs in the selected ranges, or null for all
  const PAPER = { width: 680, height: 384 }; // px, fits A4 and Letter
  let size = {}; // of the plots, where it is not that of the page

  // plotly.js reads a subset of HTML in texts.
  const plain = (text) => String(text).replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;");
  const title = (column) => (column.name || "number of the design") + (column.unit ? ` (${column.unit})` : "");
  const isText = (column) => column.values.some((value) => typeof value === "string");
  const color = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

  function valueText(value, unit) {
    if (value === null) return "-";
    if (typeof value === "string") return value;
    const size = Math.abs(value);
    const digits = size < 1e4 || size >= 1e7 ? String(Number(value.toPrecision(4))) : value.toFixed(0);
    return `${digits}${unit ? ` ${unit}` : ""}`;
  }

  // -- the plot of two columns ---------------------------------------------------------------

  const GROUPS = [
    { name: "excluded", color: "out", symbol: "x-thin", size: 7, has: (i) => !passed[i] },
    { name: "ok", color: "passed", symbol: "circle", size: 7, has: (i) => passed[i] && !data.front[i] },
    {
      name: data.columns.filter((column) => column.kind === "objective").length > 1 ? "front" : "best",
      color: "front", symbol: "diamond", size: 11, has: (i) => data.front[i],
    },
  ];

  function axis(column) {
    return {
      title: { text: plain(title(column) + (column.goal ? `, ${column.goal}` : "")), standoff: 8 },
      type: isText(column) ? "category" : "linear",
      gridcolor: color("rule"), zeroline: false, linecolor: color("out"), automargin: true,
    };
  }

  function drawPlot() {
    const [x, y] = ["x", "y"].map((id) => columns[element(id).selectedIndex]);
    const drawable = (i) => x.values[i] !== null && y.values[i] !== null;
    const texts = (values) => (values.some((v) => typeof v === "string") ? values.map(plain) : values);
    const traces = GROUPS.map((group) => {
      const rows = data.samples.map((_, i) => i).filter((i) => group.has(i) && drawable(i));
      return {
        name: `${group.name} (${rows.length})`,
        type: hasWebgl && count > MANY ? "scattergl" : "scatter",
        mode: "markers",
        x: texts(rows.map((i) => x.values[i])),
        y: texts(rows.map((i) => y.values[i])),
        customdata: rows.map((i) => data.samples[i]),
        hovertemplate: "design %{customdata}<br>%{x:.5~g}, %{y:.5~g}<extra></extra>",
        marker: { color: color(group.color), symbol: group.symbol, size: count > MANY ? group.size - 2 : group.size,
          opacity: count > MANY && group.name === "ok" ? 0.5 : 1,
          line: { width: group.symbol === "x-thin" ? 1.5 : 0.5, color: group.symbol === "x-thin" ? color(group.color) : color("page") } },
        selectedpoints: brushed === null ? null : rows.flatMap((i, k) => (brushed.has(data.samples[i]) ? [k] : [])),
        unselected: { marker: { opacity: 0.12 } },
      };
    });
    const place = data.samples.indexOf(chosen);
    const ring = place >= 0 && drawable(place);
    traces.push({
      type: "scatter", mode: "markers", hoverinfo: "skip", showlegend: false,
      x: ring ? texts([x.values[place]]) : [], y: ring ? texts([y.values[place]]) : [],
      marker: { symbol: "circle-open", size: 20, color: color("ink"), line: { width: 2.5 } },
    });
    Plotly.react("plot", traces, {
      ...size, margin: { l: 60, r: 12, t: 10, b: 50 }, hovermode: "closest", dragmode: "pan",
      paper_bgcolor: "transparent", plot_bgcolor: "transparent",
      font: { family: getComputedStyle(document.body).fontFamily, color: color("ink"), size: 13 },
      xaxis: axis(x), yaxis: axis(y), legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0 },
    }, config);
  }

  // -- the chosen design ----------------------------------------------------------------------

  function showDesign(sample) {
    chosen = sample;
    const place = data.samples.indexOf(sample);
    const message = place < 0 ? "" : data.messages[data.messageOf[place]];
    element("title").textContent = place < 0 ? "Start robot"
      : `Design ${sample}${data.front[place] ? `: ${GROUPS[2].name}` : passed[place] ? "" : `: ${data.statuses[place]}`}`;
    element("message").textContent = message;
    element("message").hidden = !message;
    element("values").replaceChildren(...(place < 0 ? [] : data.columns).map((column) => {
      const row = document.createElement("tr");
      const name = document.createElement("th");
      const value = document.createElement("td");
      name.scope = "row";
      name.textContent = column.name + (column.goal ? ` (${column.goal})` : "");
      value.textContent = valueText(column.values[place], column.unit);
      row.append(name, value);
      return row;
    }));
    let hasRobot = false;
    for (const robot of document.querySelectorAll("article.robot")) {
      robot.hidden = Number(robot.dataset.design) !== sample;
      hasRobot ||= !robot.hidden;
    }
    element("no-robot").hidden = hasRobot;
    element("picture").hidden = true;
    for (const button of document.querySelectorAll(".gallery button")) {
      const isChosen = Number(button.dataset.design) === sample;
      const small = button.querySelector("img");
      button.setAttribute("aria-pressed", String(isChosen));
      if (isChosen && small) {
        element("picture").src = small.src;
        element("picture").alt = `Picture of ${place < 0 ? "the start robot" : `design ${sample}`}`;
        element("picture").hidden = false;
      }
    }
  }

  // -- parallel coordinates -------------------------------------------------------------------

  const MOST_LINES = 2000; // besides the front; more of them are an area, and slow without a graphics card
  const complete = data.samples.map((_, i) => i)
    .filter((i) => passed[i] && data.columns.every((column) => column.values[i] !== null));
  const others = complete.filter((i) => !data.front[i]);
  const step = Math.max(others.length / MOST_LINES, 1);
  // The lines of the front are drawn last, above the others.
  const lines = [...others.filter((_, k) => Math.floor(k / step) !== Math.floor((k - 1) / step)), ...complete.filter((i) => data.front[i])];

  // Ticks of parallel coordinates are plain texts.  The end of the name of a module type says most.
  const shortened = (word) => (word.length > 18 ? `…${word.slice(-17)}` : word);

  // Values as numbers on the axis of a column: texts by their places in the order of appearance.
  function numbers(column, rows) {
    if (!isText(column)) return rows.map((i) => column.values[i]);
    const places = new Map([...new Set(column.values)].map((word, k) => [word, k]));
    return rows.map((i) => places.get(column.values[i]));
  }

  function dimension(column) {
    const words = isText(column) ? [...new Set(column.values)] : null;
    return { name: column.name, label: plain(title(column)), tickformat: ".5~r", values: numbers(column, lines),
      ...(words && { tickvals: words.map((_, k) => k), ticktext: words.map(shortened) }) };
  }

  function drawParallel() {
    if (!lines.length || !hasWebgl) {
      element("parallel").textContent = lines.length ? "This browser has no WebGL, which the lines need." : "No design has all values.";
      element("parallel").style.height = "auto";
      return;
    }
    const isFirst = !element("parallel").data;
    if (lines.length < complete.length)
      element("thinned").textContent = `The lines are the front and ${lines.length - complete.length + others.length} of the other ${others.length} designs.`;
    element("parallel").style.minWidth = size.width ? "" : `${Math.max(data.columns.length * 105, 300)}px`;
    Plotly.react("parallel", [{
      type: "parcoords", dimensions: data.columns.map(dimension), labelangle: 0,
      line: { color: lines.map((i) => Number(data.front[i])), cmin: 0, cmax: 1, showscale: false,
        colorscale: [[0, color("line")], [1, color("front")]] },
      unselected: { line: { color: color("rule"), opacity: 0.3 } },
      labelfont: { size: 12, color: color("ink") }, tickfont: { size: 11, color: color("ink") },
      rangefont: { size: 11, color: color("soft") },
    }], {
      ...size, margin: { l: isText(data.columns[0]) ? 130 : 60, r: 60, t: 50, b: 30 }, paper_bgcolor: "transparent", plot_bgcolor: "transparent",
      font: { family: getComputedStyle(document.body).fontFamily, color: color("ink") },
    }, { ...config, displayModeBar: false });
    if (isFirst) element("parallel").on("plotly_restyle", readRanges);
  }

  function readRanges() {
    const ranges = element("parallel").data[0].dimensions.filter((each) => each.constraintrange).map((each) => [
      numbers(data.columns.find((column) => column.name === each.name), complete),
      Array.isArray(each.constraintrange[0]) ? each.constraintrange : [each.constraintrange],
    ]);
    const inside = complete.filter((_, k) =>
      ranges.every(([values, parts]) => parts.some(([least, most]) => values[k] >= least && values[k] <= most)));
    brushed = ranges.length ? new Set(inside.map((i) => data.samples[i])) : null;
    element("brushed").textContent = brushed === null ? "" : `${inside.length} of ${complete.length} designs are in the selected ranges.`;
    drawPlot();
  }

  // -- start ------------------------------------------------------------------------------------

  for (const [index, id] of ["x", "y"].entries()) {
    const select = element(id);
    for (const column of columns) select.add(new Option(title(column), column.name, false, column.name === data.axes[index]));
    select.addEventListener("change", drawPlot);
  }
  for (const button of document.querySelectorAll(".gallery button"))
    button.addEventListener("click", () => {
      showDesign(Number(button.dataset.design));
      drawPlot();
    });
  showDesign(chosen);
  drawPlot();
  element("plot").on("plotly_click", (event) => {
    const sample = event.points[0].customdata;
    if (sample === undefined) return;
    showDesign(sample);
    drawPlot();
  });
  // Without a graphics card, the lines take seconds: they are drawn when they come into view.
  const view = new IntersectionObserver((entries) => {
    if (!entries.some((entry) => entry.isIntersecting)) return;
    view.disconnect();
    drawParallel();
  }, { rootMargin: "200px" });
  view.observe(element("parallel"));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
    drawPlot();
    if (element("parallel").data) drawParallel();
  });
  for (const [event, paper] of [["beforeprint", PAPER], ["afterprint", {}]])
    window.addEventListener(event, () => {
      size = paper;
      document.documentElement.classList.toggle("paper", Boolean(size.width)); // light colours
      drawPlot();
      drawParallel();
    });
  document.documentElement.dataset.ready = "yes";
}
