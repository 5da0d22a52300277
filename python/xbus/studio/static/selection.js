// The table of what is at the cursors A and B and between them.
import { clock } from "/static/clock.js";

export default {
  template: `
    <div v-if="cursors.length" class="xbus-selection">
      <div class="xbus-facts">
        <span v-for="{ name, time, active } in cursors" :key="name" :class="{ 'xbus-active': active }"
          :data-cursor="name" :data-time="time">{{ name }} {{ clock(time, elapsed) }}</span>
        <span v-if="apart">{{ apart }}</span>
      </div>
      <table class="xbus-table xbus-mono">
        <thead><tr><th v-for="[name, title] in heads" :key="name" :title="title">{{ name }}</th></tr></thead>
        <tbody v-for="group in groups" :key="group.name" :data-series="group.name">
          <tr><td :colspan="heads.length"><b>{{ group.title }}</b>
            <span v-for="note in group.notes" :key="note" class="xbus-quiet">{{ note }}</span></td></tr>
          <tr v-for="row in group.rows" :key="row[0]">
            <td v-for="(text, at) in row" :key="at" :class="{ 'xbus-stale': group.old.includes(heads[at][0]) }">{{ text }}</td>
          </tr>
        </tbody>
      </table>
    </div>`,
  props: { cursors: Array, apart: String, heads: Array, groups: Array, elapsed: Boolean },
  methods: { clock },
};
