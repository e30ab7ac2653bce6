// Written by tools/vendor.py, for tsc only.
export { h, render, Fragment, createContext, createRef } from 'preact';
export { useCallback, useEffect, useLayoutEffect, useMemo, useRef, useState } from 'preact/hooks';
export { html } from 'htm/preact';
export { batch, computed, effect, signal, untracked, useComputed, useSignal, useSignalEffect } from '@preact/signals';
