// The text editor of the playground (CodeMirror).  `npm run build` bundles it.

import { autocompletion, closeBrackets, closeBracketsKeymap, completionKeymap, snippet } from "@codemirror/autocomplete";
import { defaultKeymap, history, historyKeymap, indentWithTab, temporarilySetTabFocusMode } from "@codemirror/commands";
import { yaml } from "@codemirror/lang-yaml";
import { bracketMatching, HighlightStyle, indentOnInput, indentService, indentUnit, syntaxHighlighting } from "@codemirror/language";
import { lintGutter, lintKeymap, setDiagnostics } from "@codemirror/lint";
import { highlightSelectionMatches, searchKeymap } from "@codemirror/search";
import { Compartment, EditorState, RangeSetBuilder } from "@codemirror/state";
import { Decoration, drawSelection, EditorView, highlightActiveLine, keymap, lineNumbers, ViewPlugin } from "@codemirror/view";
import { tags } from "@lezer/highlight";

const COLORS = HighlightStyle.define([
  { tag: tags.comment, color: "var(--quiet)", fontStyle: "italic" },
  { tag: [tags.definition(tags.propertyName), tags.propertyName], color: "var(--accent)" },
  { tag: [tags.string, tags.content], color: "var(--text)" },
]);

const LOOK = EditorView.theme({
  "&": { height: "100%", color: "var(--text)", backgroundColor: "var(--panel)", fontSize: "13px" },
  ".cm-scroller": { fontFamily: "ui-monospace, monospace", lineHeight: "1.5" },
  ".cm-content": { caretColor: "var(--text)" },
  ".cm-gutters": { backgroundColor: "var(--panel)", color: "var(--quiet)", border: "0" },
  ".cm-activeLine, .cm-activeLineGutter": { backgroundColor: "var(--wash)" },
  "&.cm-focused": { outline: "2px solid var(--accent)", outlineOffset: "-2px" },
  ".cm-cursor": { borderLeftColor: "var(--text)" },
  ".cm-tooltip, .cm-panels": { backgroundColor: "var(--panel)", color: "var(--text)", border: "1px solid var(--line)" },
  ".cm-tooltip-autocomplete ul li[aria-selected]": { backgroundColor: "var(--accent)", color: "var(--panel)" },
  ".cm-completionInfo": { maxWidth: "320px", whiteSpace: "pre-wrap", fontSize: "12px" },
  ".cm-diagnosticAction": { font: "inherit", fontSize: "12px", color: "var(--text)", backgroundColor: "var(--wash)",
    border: "1px solid var(--accent)", cursor: "pointer" },
});

// The tab stops of a snippet: `$1` is `${1}` here, and the end `$0` is `${}`.
const tabStops = (text) => text.replace(/\$(\d)/g, (_, number) => (number === "0" ? "${}" : `\${${number}}`));

const unitsOf = (text, characters) => [...text].slice(0, characters).join("").length;

// A place of the compiler: line and column of a Unicode character, from 1.
function offset(document, [line, column]) {
  if (line > document.lines) return document.length;
  const { from, text } = document.line(Math.max(line, 1));
  return from + unitsOf(text, column - 1);
}

// A new line after `key:` is one step further in.
const BELOW_KEY = indentService.of((context, position) => {
  const { text, from } = context.lineAt(position, -1), before = text.slice(0, position - from);
  return /^[^#]*:\s*$/.test(before) ? before.search(/\S/) + context.unit : undefined;
});

// The further rows of a wrapped line are indented as its text.
const HANGING = ViewPlugin.define((view) => ({
  rows: hanging(view),
  update(change) { if (change.docChanged || change.viewportChanged) this.rows = hanging(change.view); },
}), { decorations: (plugin) => plugin.rows });

function hanging(view) {
  const rows = new RangeSetBuilder();
  for (const { from, to } of view.visibleRanges)
    for (let place = from; place <= to;) {
      const line = view.state.doc.lineAt(place), indent = Math.max(line.text.search(/[^\s-]/), 0) + 2;
      rows.add(line.from, line.from, Decoration.line({ attributes: { style: `padding-left: calc(6px + ${indent}ch); text-indent: -${indent}ch` } }));
      place = line.to + 1;
    }
  return rows.finish();
}

// The help of the compiler, which is Markdown with code, bold text and paragraphs.
function rendered(text) {
  const help = document.createElement("div");
  for (const part of text.split(/(`[^`]+`|\*\*[^*]+\*\*)/)) {
    const [, code, bold] = /^`(.+)`$|^\*\*(.+)\*\*$/s.exec(part) ?? [];
    const piece = document.createElement(code ? "code" : bold ? "b" : "span");
    piece.textContent = code ?? bold ?? part;
    help.append(piece);
  }
  return help;
}

const characters = (document, position) => [...document.sliceString(0, position)].length;

// - onChange: called with the text after each change by the user.
// - complete: async function that returns proposals for a text and an offset in characters.
export function create(parent, { onChange, complete, label }) {
  let isSilent = false;
  const source = async (context) => {
    const line = context.state.doc.lineAt(context.pos), before = line.text.slice(0, context.pos - line.from);
    if (!context.explicit && !/[\w/.:{$ -]$/.test(before)) return null;
    const text = context.state.doc.toString();
    const answer = await complete(text, characters(context.state.doc, context.pos));
    if (!answer?.proposals.length || context.aborted) return null;
    const start = unitsOf(text, answer.start);
    if (!context.explicit && start === context.pos && !/[:{ ]$/.test(before)) return null;
    const options = answer.proposals.map((proposal, number) => {
      const from = start + proposal.start;
      return {
        label: proposal.label,
        detail: proposal.detail || undefined,
        info: proposal.documentation ? () => rendered(proposal.documentation) : undefined,
        boost: -number,
        apply: (view, completion, _, to) => {
          const end = view.state.sliceDoc(to, to + 1) === ":" && proposal.text.endsWith(":") ? -1 : undefined;
          const inserted = proposal.text.slice(0, end);
          if (proposal.is_snippet) snippet(tabStops(inserted))(view, completion, from, to);
          else view.dispatch({ changes: { from, to, insert: inserted }, selection: { anchor: from + inserted.length }, userEvent: "input.complete" });
        },
      };
    });
    return { from: start + Math.min(...answer.proposals.map((proposal) => proposal.start)), options, filter: true };
  };
  const readOnly = new Compartment();
  const states = new Map(); // of files that were shown, with their undo steps
  let shown = "";
  const view = new EditorView({ parent });
  const extensions = [
    lineNumbers(), history(), drawSelection(), indentOnInput(), bracketMatching(), closeBrackets(), highlightActiveLine(), highlightSelectionMatches(),
    EditorView.lineWrapping, HANGING, BELOW_KEY, lintGutter(), yaml(), syntaxHighlighting(COLORS), LOOK, indentUnit.of("  "), EditorState.tabSize.of(2),
    autocompletion({ override: [source], icons: false, activateOnTypingDelay: 50 }),
    readOnly.of([]),
    // Escape and then Tab leaves the editor, for people who use the keyboard alone.
    keymap.of([{ key: "Escape", run: temporarilySetTabFocusMode }]),
    keymap.of([...closeBracketsKeymap, ...completionKeymap, ...lintKeymap, ...searchKeymap, ...historyKeymap, ...defaultKeymap, indentWithTab]),
    EditorView.contentAttributes.of({ "aria-label": `${label}; Escape and then Tab leaves it`, tabindex: "0" }),
    EditorView.updateListener.of((update) => {
      if (update.docChanged && !isSilent) onChange(view.state.doc.toString());
    }),
  ];
  return {
    view,
    get text() { return view.state.doc.toString(); },
    // Shows another file, with its undo steps if it is the text that was shown under this key.
    open(text, isReadOnly, key) {
      states.set(shown, view.state);
      shown = key;
      const state = states.get(key);
      isSilent = true;
      view.setState(state?.doc.toString() === text ? state : EditorState.create({ doc: text, extensions }));
      view.dispatch({ effects: readOnly.reconfigure(EditorState.readOnly.of(isReadOnly)) });
      isSilent = false;
    },
    // Diagnostics of the compiler for this file.
    mark(diagnostics) {
      const { doc } = view.state;
      const marks = diagnostics.filter(({ span }) => span).map((diagnostic) => {
        const from = offset(doc, diagnostic.span.start), to = Math.max(from, offset(doc, diagnostic.span.end));
        const actions = diagnostic.fixes.map(({ span, text }) => ({
          name: diagnostic.fixes.length === 1 && diagnostic.hint ? diagnostic.hint : text.trim() || "remove it",
          apply: () => view.dispatch({ changes: { from: offset(view.state.doc, span.start), to: offset(view.state.doc, span.end), insert: text } }),
        }));
        const hint = diagnostic.hint && actions.length !== 1 ? `\nhint: ${diagnostic.hint}` : "";
        return { from, to, severity: diagnostic.severity === "note" ? "info" : diagnostic.severity, source: diagnostic.code,
          message: `${diagnostic.message}${hint}`, actions };
      });
      view.dispatch(setDiagnostics(view.state, marks));
    },
    // Inserts a text at an offset in characters, and shows it.
    insert(text, at) {
      const from = unitsOf(view.state.doc.toString(), at);
      view.dispatch({ changes: { from, insert: text }, selection: { anchor: from + text.trimEnd().length }, scrollIntoView: true, userEvent: "input" });
    },
    // Puts the cursor at a place of the compiler.
    show(place) {
      view.dispatch({ selection: { anchor: offset(view.state.doc, place) }, scrollIntoView: true });
      view.focus();
    },
  };
}
